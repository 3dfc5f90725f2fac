"""MATLAB files: sound ones come in to the bit, damaged ones are refused, whatever they do to a reader."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from rig.errors import BadInput
from rig.foreign import enclosed
from rig.foreign.enclosed import Found

RANDOM = np.random.default_rng(6)
WHOLE: dict[str, Any] = {
    "t": np.arange(40.0) / 100.0, "imu": {"gyro": RANDOM.normal(size=(3, 40)), "counts": np.arange(40, dtype=np.int16)},
    "note": "by hand",
}  # fmt: skip


def arrays(raw: bytes) -> Found:
    return enclosed.arrays(raw, "mat")


def written(compressed: bool) -> bytes:
    file = io.BytesIO()
    savemat(file, WHOLE, do_compression=compressed)
    return file.getvalue()


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_and_fields_come_in_to_the_bit(compressed: bool) -> None:
    found = dict(arrays(written(compressed)))
    assert sorted(found) == ["imu.counts", "imu.gyro", "t"]
    assert found["t"].reshape(-1).tobytes() == WHOLE["t"].tobytes()
    assert found["imu.gyro"].tobytes() == WHOLE["imu"]["gyro"].tobytes()
    assert found["imu.counts"].dtype == np.int16


@pytest.mark.parametrize("place", [136, 140, 144, 152, 160, 164, 168, 200, 480, 488, 496, 520])
def test_a_damaged_file_is_refused_or_read_and_never_ends_the_program(place: int) -> None:
    raw = bytearray(written(compressed=False))
    raw[place : place + 4] = bytes([255, 255, 255, 127])
    try:
        said = [array.dtype.kind for _, array in arrays(bytes(raw))]
    except BadInput as error:
        said = [str(error)]
    assert all(one in "biuf" or "MAT file" in one for one in said)


def test_a_reader_that_dies_by_a_signal_is_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enclosed, "__name__", "rig.foreign.there_is_none")
    with pytest.raises(BadInput, match="its reader stopped"):
        list(arrays(written(compressed=True)))


@pytest.mark.parametrize("cut", [0, 3, 130, 300])
def test_a_file_that_is_cut_is_refused(cut: int) -> None:
    with pytest.raises(BadInput, match="MAT file"):
        list(arrays(written(compressed=True)[:cut]))


def test_version_7_3_is_named() -> None:
    raw = b"MATLAB 7.3 MAT-file".ljust(124) + (b"\0\2IM" if sys.byteorder == "little" else b"\2\0MI") + bytes(512)
    with pytest.raises(BadInput, match="HDF5"):
        list(arrays(raw))


@pytest.mark.parametrize(("form", "save"), [("npy", np.save), ("npz", np.savez)])
def test_other_formats_are_read_there_too_and_cut_ones_refused(form: str, save: Callable[..., None]) -> None:
    file = io.BytesIO()
    save(file, WHOLE["t"])
    ((_, array),) = enclosed.arrays(file.getvalue(), form)
    assert array.tobytes() == WHOLE["t"].tobytes()
    with pytest.raises(BadInput, match=f"found no {form.upper()} file of plain numbers"):
        list(enclosed.arrays(file.getvalue()[:90], form))


def ended(work: Callable[[], object]) -> int:
    """Exit code of a copy of this process that does this once it is confined."""
    child = os.fork()
    if child == 0:
        try:
            enclosed.confine(0)
            work()
        except MemoryError:
            os._exit(7)
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_who_asks_for_more_memory_than_a_sound_file_needs_does_not_get_it() -> None:
    assert ended(lambda: bytearray(enclosed.MEMORY // 2)) == 0
    assert ended(lambda: bytearray(enclosed.MEMORY * 2)) == 7


def test_who_is_busy_for_longer_than_a_sound_file_needs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enclosed, "SECONDS", 1.0)

    def for_ever() -> None:
        while True:
            pass

    assert ended(for_ever) == -signal.SIGXCPU
