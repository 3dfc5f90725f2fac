"""The proxy of the fault matrix really does what it says, and nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import os
import struct
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import numpy as np
import pytest
from wire_proxy import HEADER, HOST, Bus, Frames, Lines, Proxy, Spoilt, framed

from drivers.das16jr import FrameParser

CODES = np.arange(4 * 16, dtype="<u2")  # four scans of sixteen channels
BLOCK = b"#216" + struct.pack(">dd", 1.0, -2.5) + b"\n"
END = b"<end>\n"
Talk = Callable[[asyncio.StreamReader, asyncio.StreamWriter, Proxy], Awaitable[bytes]]


class _Instrument(asyncio.Protocol):
    """Answers every line with itself in angle brackets, the line "block" with two reals; keeps what it heard."""

    def __init__(self, heard: list[bytes]) -> None:
        self._heard = heard

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport: Any = transport

    def data_received(self, data: bytes) -> None:
        for line in data.splitlines():
            self._heard.append(line)
            if not line.startswith(b"++"):
                self._transport.write(BLOCK if line == b"block" else b"<" + line + b">\n")


def through(spoilt: Spoilt, talk: Talk, language: Callable[[], Any] = Lines) -> tuple[bytes, list[bytes]]:
    """What a client makes of its talk through the proxy, and what the instrument heard."""
    heard: list[bytes] = []

    async def run() -> bytes:
        server = await asyncio.get_running_loop().create_server(lambda: _Instrument(heard), HOST, 0)
        proxy = Proxy(language, server.sockets[0].getsockname()[1], [spoilt])
        reader, writer = await asyncio.open_connection(HOST, await proxy.listen())
        try:
            return await talk(reader, writer, proxy)
        finally:
            writer.close()
            proxy.close()
            server.close()

    return asyncio.run(run()), heard


def cut(proxy: Proxy) -> bool:
    """Whether it has hung up."""
    return any(one.kind == "disconnect" for one in proxy.injected)


def asking(*questions: bytes) -> Talk:
    """Ask one after the other, each when the one before was answered, and give all that arrives before `END`."""

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, proxy: Proxy) -> bytes:
        for question in (*questions, b"end"):
            if cut(proxy):
                break
            expected = proxy.answers + 1
            writer.write(question + b"\n")
            while proxy.answers < expected and not cut(proxy):
                await asyncio.sleep(0)
        found = b""
        with contextlib.suppress(ConnectionResetError):
            while not found.endswith(END) and (piece := await reader.read(1000)):
                found += piece
        return found.removesuffix(END)

    return talk


@pytest.mark.parametrize(
    ("spoilt", "found"),
    [
        (Spoilt("duplicated", "never"), b"<one>\n<two>\n<three>\n"),
        (Spoilt("duplicated", "two"), b"<one>\n<two>\n<two>\n<three>\n"),
        (Spoilt("previous", "two"), b"<one>\n<one>\n<three>\n"),
        (Spoilt("behind", "two|three"), b"<one>\n<one>\n<two>\n"),
        (Spoilt("other", "two", says=b"2\n"), b"<one>\n2\n<three>\n"),
        (Spoilt("other", "one|two|three", 1, says=b"2\n"), b"<one>\n2\n<three>\n"),
        (Spoilt("other", "one|two|three", 1, says=b"2\n", lasting=True), b"<one>\n2\n2\n"),
        (Spoilt("silence", "two"), b"<one>\n<three>\n"),
        (Spoilt("truncated", "two"), b"<one>\n<tw<three>\n"),
        (Spoilt("flipped", "two", bit=0, place=1), b"<one>\n<uwo>\n<three>\n"),
        (Spoilt("late", "two", size=0.01), b"<one>\n<two>\n<three>\n"),
        (Spoilt("disconnect", "two"), b"<one>\n"),
    ],
)
def test_an_answer_is_spoilt_as_it_was_told_and_no_other(spoilt: Spoilt, found: bytes) -> None:
    got, heard = through(spoilt, asking(b"one", b"two", b"three"))
    assert got == found
    assert heard[:2] == [b"one", b"two"]


def test_garbage_is_as_long_and_ends_as_the_answer_did() -> None:
    got, _ = through(Spoilt("garbage", "two"), asking(b"two"))
    assert len(got) == len(b"<two>\n")
    assert got.endswith(b"\n")
    assert got != b"<two>\n"


def test_a_late_answer_keeps_what_follows_waiting() -> None:
    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, proxy: Proxy) -> bytes:
        began = asyncio.get_running_loop().time()
        found = await asking(b"one", b"two")(reader, writer, proxy)
        assert asyncio.get_running_loop().time() - began >= 0.05
        return found

    assert through(Spoilt("late", "one", size=0.05), talk)[0] == b"<one>\n<two>\n"


def test_what_hangs_takes_everything_and_gives_nothing_also_to_those_who_come_later() -> None:
    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, proxy: Proxy) -> bytes:
        writer.write(b"one\n")
        while not proxy.hung:
            await asyncio.sleep(0)
        writer.write(b"two\n")
        port = proxy._server.sockets[0].getsockname()[1]  # type: ignore[union-attr]
        later, other = await asyncio.open_connection(HOST, port)
        other.write(b"three\n")
        for stream in (reader, later):
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(stream.read(1), 0.05)
        other.close()
        return b""

    assert through(Spoilt("hung", "one"), talk)[1] == [b"one"]


def test_another_client_is_heard_before_the_answer_comes() -> None:
    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, proxy: Proxy) -> bytes:
        found = b""
        for question in (b"one\n", b"two\n"):
            writer.write(question)
            found += await reader.readline()
        return found

    got, heard = through(Spoilt("second_client", "one", says=b"OUTP OFF\n"), talk)
    assert got == b"<one>\n<two>\n"
    assert heard == [b"one", b"OUTP OFF", b"two"]


def test_answers_on_a_bus_are_told_apart_by_address_and_blocks_are_whole() -> None:
    spoilt = Spoilt("scaled", "^19:block", size=2.0)
    got, _ = through(spoilt, asking(b"++addr 7\nblock\n++read eoi", b"++addr 19\nblock\n++read eoi"), Bus)
    assert got == BLOCK + b"#216" + struct.pack(">dd", 2.0, -5.0) + b"\n"
    got, _ = through(Spoilt("flipped", "block", bit=7, place=0), asking(b"++addr 7\nblock"), Bus)
    assert got == b"#216" + struct.pack(">dd", -1.0, -2.5) + b"\n"
    got, _ = through(Spoilt("not_a_number", "block"), asking(b"++addr 7\nblock"), Bus)
    assert np.isnan(struct.unpack(">dd", got[4:20])).all()


def test_numbers_in_text_become_what_is_not_one() -> None:
    assert through(Spoilt("not_a_number", "2.5"), asking(b"2.5E+3;7"))[0] == b"<NAN;7>\n"
    assert through(Spoilt("number", "2.5", size=1.1, place=1), asking(b"2.5E+3;70"))[0] == b"<2.5E+3;77>\n"
    assert through(Spoilt("number", "2.5", size=2.0, place=0), asking(b"2.5;70"))[0] == b"<5.0000000000E+00;70>\n"
    assert through(Spoilt("overload", "2.5"), asking(b"2.5E+3;7"))[0] == b"<9.90000E+37;7>\n"


def frames(spoilt: Spoilt, count: int = 3) -> tuple[list[Any], str | None]:
    """Frames of four scans each as the driver's own parser sees them behind the proxy, and what it finds damaged."""
    payload = CODES.tobytes()
    whole = b"".join(framed((b"RDAQ", 1, 1, 5, 64 * n, 1000 * n, 20_000, 16, 0, 0), payload) for n in range(count))

    async def run() -> bytes:
        server = await asyncio.start_server(lambda _, writer: writer.write(whole), HOST, 0)
        proxy = Proxy(Frames, server.sockets[0].getsockname()[1], [spoilt])
        reader, writer = await asyncio.open_connection(HOST, await proxy.listen())
        while proxy.answers < count:
            await asyncio.sleep(0)
        writer.write_eof()
        found = b""
        while len(found) < len(whole) // 2 or not reader.at_eof():
            try:
                piece = await asyncio.wait_for(reader.read(100_000), 0.05)
            except TimeoutError:
                break
            found += piece
            if not piece:
                break
        writer.close()
        proxy.close()
        server.close()
        return found

    parser = FrameParser()
    return parser.feed(asyncio.run(run())), parser.damage


@pytest.mark.parametrize(
    ("kind", "codes", "indices"),
    [
        ("none", [64, 64, 64], [0, 64, 128]),
        ("lost", [64, 64], [0, 128]),
        ("doubled", [64, 64, 64, 64], [0, 64, 64, 128]),
        ("lost_scans", [64, 48, 64], [0, 64, 128]),
        ("doubled_scans", [64, 80, 64], [0, 64, 128]),
        ("hidden_loss", [64, 48, 64], [0, 64, 112]),
        ("hidden_double", [64, 80, 64], [0, 64, 144]),
        ("slipped", [64, 63, 64], [0, 64, 127]),
    ],
)
def test_frames_scans_and_conversions_are_lost_and_doubled(kind: str, codes: Sequence[int], indices: list[int]) -> None:
    found, damage = frames(Spoilt(kind, "samples" if kind != "none" else "never", 1))
    assert not damage
    assert [len(one.codes) for one in found] == codes
    assert [one.index for one in found] == indices


def test_a_bit_flips_with_and_without_the_check_sum_telling() -> None:
    found, damage = frames(Spoilt("flipped", "samples", 1))
    assert damage
    assert len(found) == 1
    found, damage = frames(Spoilt("inside", "samples", 1, bit=3, place=8))
    assert not damage
    assert found[1].codes[4] == CODES[4] ^ 8
    assert np.count_nonzero(found[1].codes != CODES) == 1
    assert HEADER.size == 40


def test_a_terminal_passes_on_both_ways_and_its_plug_can_be_pulled() -> None:
    async def run() -> tuple[bytes, bool]:
        loop, heard = asyncio.get_running_loop(), list[bytes]()
        server = await loop.create_server(lambda: _Instrument(heard), HOST, 0)
        proxy = Proxy(Lines, server.sockets[0].getsockname()[1], [Spoilt("disconnect", "two")])
        client = os.open(await proxy.terminal(), os.O_RDWR | os.O_NOCTTY)
        os.write(client, b"one\n")
        arrived = loop.create_future()
        loop.add_reader(client, lambda: arrived.done() or arrived.set_result(os.read(client, 100)))
        first = await asyncio.wait_for(arrived, 30)
        loop.remove_reader(client)
        os.write(client, b"two\n")
        while not proxy.injected:
            await asyncio.sleep(0)
        try:
            pulled = os.read(client, 100) == b""
        except OSError:
            pulled = True
        os.close(client)
        server.close()
        return first, pulled

    assert asyncio.run(run()) == (b"<one>\n", True)
