"""The vibrometer's driver: its reply parser alone, and the whole over real serial lines."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers import ofv3001
from drivers.ofv3001 import LIMITS, MESSAGES, Settings, parse_reply
from fixtures.ofv3001 import OFV3001
from fixtures.serial_line import Line, Plug, Terminal
from rig.errors import BadReply, NoAnswer, SettingRefused, SignalLow, SignalOverload, WrongIdentity
from rig.room import Confirmation, Request, Room

# --- the reply parser -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("query", "line", "number"),
    [
        ("VELO?", b"5\n", 5),
        ("VELO?", b"VELO5\n", 5),
        ("OVR", b"0\r\n", 0),
        ("OVR", b"OVR1\n", 1),
        ("LEV", b"LEV37\n", 37),
        ("REM", b"REM0\n", 0),
        ("LEV", b"LEV\n", None),
        ("VELO?", b"VELO?\n", None),
        ("REM", b"REN\n", None),
    ],
)
def test_replies_are_read_in_both_echo_modes(query: str, line: bytes, number: int | None) -> None:
    assert parse_reply(query, line) == number


@pytest.mark.parametrize(
    ("query", "line"),
    [("VELO?", b"0\n"), ("VELO?", b"10\n"), ("OVR", b"2\n"), ("LEV", b"41\n"), ("LEV", b"OVR1\n"), ("REM", b"\n")],
)
def test_numbers_that_cannot_be_are_no_reply(query: str, line: bytes) -> None:
    with pytest.raises(ValueError, match="…"):
        parse_reply(query, line)


@given(st.sampled_from(sorted(LIMITS)), st.binary(max_size=30))
def test_any_line_gives_a_number_in_range_an_echo_or_a_value_error(query: str, line: bytes) -> None:
    low, high = LIMITS[query]
    try:
        number = parse_reply(query, line)
    except ValueError:
        return
    assert number is None or low <= number <= high


@given(st.sampled_from(sorted(LIMITS)), st.integers(0, 40), st.booleans(), st.sampled_from(["\n", "\r\n", ""]))
def test_every_true_reply_is_read_back(query: str, number: int, echo: bool, end: str) -> None:
    low, high = LIMITS[query]
    true = min(max(number, low), high)
    assert parse_reply(query, f"{query.rstrip('?') if echo else ''}{true}{end}".encode()) == true


# --- over real lines --------------------------------------------------------------------------------------------------


@dataclass
class Optics:
    scale: float = 0.0
    level: float = 37.0
    over: bool = False

    def take_overrange(self) -> bool:
        over, self.over = self.over, False
        return over


@dataclass
class KnownWorld:
    """A world in which only time passes."""

    now: float = 0.0
    faults: dict[str, Any] = field(default_factory=dict)
    vibrometer: Optics = field(default_factory=Optics)
    events: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    def advance(self, seconds: float) -> None:
        self.now += seconds

    def subscribe(self, callback: Callable[[float, float], None]) -> None:
        return None

    def log(self, event: str, **details: Any) -> None:
        self.events.append((event, details))


class HearingTwin(OFV3001):
    """The twin, counting the bytes that have reached it."""

    heard = 0

    def receive(self, data: bytes) -> bytes:
        self.heard += len(data)
        return super().receive(data)

    def pressed(self, data: bytes) -> None:
        """What somebody switches at the panel: it does not come over the line."""
        super().receive(data)


class Bench:
    """World, twin, a line in a thread of its own, and the driver at its end."""

    def __init__(self, kind: str, **settings: Any) -> None:
        self.world = KnownWorld()
        self.twin = HearingTwin(self.world)
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()
        self.line = Line(self.twin, lambda: None)
        self.sent: list[bytes] = []
        settings = {"decoder": "OVD-01", "timeout": "2 s"} | settings
        values = Settings.model_validate({"address": self._open(kind), **settings})
        self.ldv = ofv3001.connect("ldv", values, Room(clock=self, operator=self, transcript=self))

    def _open(self, kind: str) -> str:
        if kind == "pty":
            self.end: Any = self.call(lambda: Terminal(self.line, self.loop))
            return str(self.end.path)
        listening = self.loop.create_server(lambda: Plug(self.line), "127.0.0.1", 0)
        self.end = asyncio.run_coroutine_threadsafe(listening, self.loop).result(10)
        return f"socket://127.0.0.1:{self.end.sockets[0].getsockname()[1]}"

    def call(self, work: Callable[[], Any]) -> Any:
        async def run() -> Any:
            return work()

        return asyncio.run_coroutine_threadsafe(run(), self.loop).result(10)

    def now(self) -> float:
        return float(self.call(lambda: self.world.now))

    def sleep(self, seconds: float) -> None:
        """Let time pass once everything that was sent has been heard: the line and this clock are two ways."""

        async def pass_time() -> None:
            over = self.loop.time() + 10.0
            while self.twin.heard < sum(map(len, self.sent)) and self.loop.time() < over:
                await asyncio.sleep(0)
            self.world.advance(seconds)

        asyncio.run_coroutine_threadsafe(pass_time(), self.loop).result(60)

    def ask(self, request: Request) -> Confirmation:
        raise AssertionError("nobody is asked")

    def note(self, instrument: str, direction: str, data: bytes) -> None:
        if direction == "sent":
            self.sent.append(data)

    def close(self) -> None:
        self.ldv.close()
        self.call(self.end.close)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


@pytest.fixture(params=["pty", "socket"])
def any_bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    made = Bench(request.param)
    yield made
    made.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench("pty")
    yield made
    made.close()


@pytest.fixture(params=[b"ECHOOFF\n", b"ECHOON\n"], ids=["echo off", "echo on"])
def echoing(request: pytest.FixtureRequest, bench: Bench) -> Bench:
    bench.twin.pressed(request.param)
    return bench


def test_the_language_stands_in_for_an_identity(any_bench: Bench) -> None:
    identity = any_bench.ldv.identify()
    assert (identity.maker, identity.model) == ("Polytec", "OFV-3001")
    assert "no identity query" in identity.firmware
    assert any_bench.sent == [b"REM\n", b"VELO?\n", b"LEV\n"]


def test_connecting_sends_nothing(bench: Bench) -> None:
    assert bench.sent == []


def test_another_language_is_another_instrument(bench: Bench) -> None:
    bench.world.faults["ofv3001.garbage"] = "POLYTEC,OFV-5000"
    with pytest.raises(WrongIdentity, match=r"sent 'REM', received 'POLYTEC,OFV-5000', wanted an OFV-3001"):
        bench.ldv.identify()


@pytest.mark.parametrize(
    ("peak", "number", "scale"),
    [(0.0, 5, 1e-3), (0.008, 5, 1e-3), (0.0081, 1, 5e-3), (0.1, 2, 25e-3), (0.3, 3, 0.125), (8.0, 4, 1.0)],
)
def test_the_most_sensitive_range_with_headroom_is_set(bench: Bench, peak: float, number: int, scale: float) -> None:
    assert bench.ldv.set_range_for(peak) == scale
    assert bench.twin.state()["range"] == number
    assert bench.world.vibrometer.scale == scale


def test_every_set_is_confirmed_in_either_echo_mode(echoing: Bench) -> None:
    for peak, scale in ((0.003, 1e-3), (0.03, 5e-3), (0.003, 1e-3)):
        assert echoing.ldv.set_range_for(peak) == scale
        assert echoing.world.vibrometer.scale == scale
    sets = [at for at, message in enumerate(echoing.sent) if message in (b"VELO1\n", b"VELO5\n")]
    assert len(sets) == 3
    assert all(echoing.sent[at + 1] == b"VELO?\n" for at in sets)
    assert echoing.sent[sets[0] - 1] == b"REN\n"


def test_a_range_that_is_already_there_is_not_set_again(bench: Bench) -> None:
    bench.ldv.set_range_for(0.03)
    before = len(bench.sent)
    bench.ldv.set_range_for(0.035)
    assert bench.sent[before:] == [b"VELO?\n"]


def test_an_instrument_that_ignores_its_settings_is_found_out(echoing: Bench) -> None:
    echoing.world.faults["ofv3001.deaf"] = True
    with pytest.raises(SettingRefused, match=r"sent 'VELO1', received 'VELO\? answers 4', wanted range 1 after 5 sets"):
        echoing.ldv.set_range_for(0.03)


def test_echo_switched_at_the_panel_between_two_sets_does_no_harm(bench: Bench) -> None:
    for mode in (b"ECHOON\n", b"ECHOOFF\n", b"ECHOON\n"):
        bench.call(lambda mode=mode: bench.twin.pressed(mode))
        assert bench.ldv.set_range_for(0.03) == 5e-3
        bench.call(lambda mode=mode: bench.twin.pressed(b"ECHOOFF\n" if mode == b"ECHOON\n" else b"ECHOON\n"))
        assert bench.ldv.set_range_for(0.003) == 1e-3


def test_local_mode_is_left_again_when_somebody_pressed_the_button(bench: Bench) -> None:
    bench.ldv.set_range_for(0.03)
    bench.call(lambda: bench.twin.pressed(b"GTL\n"))
    assert bench.ldv.set_range_for(0.003) == 1e-3


@pytest.mark.parametrize("peak", [8.1, -1.0, float("nan"), float("inf")])
def test_a_velocity_no_range_holds_is_refused_and_nothing_is_sent(bench: Bench, peak: float) -> None:
    with pytest.raises(SettingRefused, match="peak"):
        bench.ldv.set_range_for(peak)
    assert bench.sent == []


def test_a_table_of_ones_own_replaces_the_makers() -> None:
    bench = Bench("pty", decoder=None, ranges={"1": "5 mm/s/V", "2": "25 mm/s/V"})
    try:
        assert bench.ldv.set_range_for(0.001) == 0.005
    finally:
        bench.close()


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"decoder": "OVD-03"},
        {"ranges": {"1": "5"}},
        {"ranges": {"10": "5 mm/s/V"}},
        {"decoder": "OVD-01", "baud": 9600},
    ],
)
def test_settings_without_a_usable_table_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Settings.model_validate({"address": "/dev/null", **values})


def test_a_look_gives_level_and_overrange(any_bench: Bench) -> None:
    any_bench.ldv.set_range_for(0.03)
    any_bench.world.vibrometer.over = True
    look = any_bench.ldv.check()
    assert (look.level, look.overrange, look.scale) == (37, True, 5e-3)
    assert not any_bench.ldv.check(require=True).overrange


def test_an_overrange_is_refused_where_trust_is_required(bench: Bench) -> None:
    bench.ldv.set_range_for(0.03)
    bench.world.faults["ofv3001.overrange"] = True
    with pytest.raises(SignalOverload, match=r"sent 'OVR', received '1', wanted a velocity below 0\.05 m/s"):
        bench.ldv.check(require=True)


def test_a_low_level_is_refused_where_trust_is_required(bench: Bench) -> None:
    bench.world.faults["ofv3001.low_level"] = True
    assert bench.ldv.level() == 2
    with pytest.raises(SignalLow, match=r"sent 'LEV', received '2', wanted at least 5 of 40 bars"):
        bench.ldv.check(require=True)


def test_silence_is_no_answer(bench: Bench) -> None:
    bench.world.faults["ofv3001.silence"] = True
    with pytest.raises(NoAnswer, match=r"sent 'LEV', wanted an answer"):
        bench.ldv.level()


def test_a_garbled_answer_shows_both_halves(bench: Bench) -> None:
    bench.world.faults["ofv3001.garbage"] = "3x"
    with pytest.raises(BadReply, match=r"sent 'LEV', received '3x', wanted 0…40"):
        bench.ldv.level()


def test_the_settings_are_what_the_instrument_says(bench: Bench) -> None:
    bench.ldv.set_range_for(0.03)
    assert bench.ldv.settings() == {
        "decoder": "OVD-01",
        "range": 1,
        "scale": 5e-3,
        "full_scale": 10.0,
        "remote": 1,
        "echo": False,
    }


@pytest.mark.parametrize("echo", [b"ECHOOFF\n", b"ECHOON\n"])
def test_the_twin_understands_every_message_that_the_driver_can_send(echo: bytes) -> None:
    twin = OFV3001(KnownWorld())
    twin.receive(echo)
    for message in MESSAGES:
        query = message.decode().strip()
        reply = twin.receive(message)
        if query in LIMITS:
            assert parse_reply(query, reply) is not None
        else:
            assert reply == (message if echo == b"ECHOON\n" else b"")
    assert twin.state()["range"] == 5
