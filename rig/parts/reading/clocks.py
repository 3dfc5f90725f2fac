"""Clocks of a recorder of its own beside the reference's: what is known of its instants only within an uncertainty.

A record of the Sensor Cube begins at an instant that is uncertain by a good part of a sample. On the shaker that is a
phase of its own for every sine, which nothing else tells: each has a time of its own, common to all channels. On the
turntable, whose motion is slow, one delay is enough for all records.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rig.model import Array, Complexes, Coordinate, Effect, Parameter, Term, Values

STEP = 1e-5  # s


class SineClock(Effect):
    """Every sine of one sweep is recorded by a clock that is not the reference's."""

    name = "recorder_clock"
    stage = "reference"
    title = "instants of a recorder of its own, sine by sine"
    equation = "a = a_shown·exp(+j·2π·f·time_p)"
    places = ("shaker",)
    missing = "the phases of all channels are off by the same time, another one at every sine"
    separate_by = "sensor and reference in one record"
    source = "fit of the cube's clock, latency of its line"

    def __init__(self, part: str, records: Sequence[int]) -> None:
        self.parts = frozenset({part})  # type: ignore[misc]
        self._records = np.array(records, np.intp)
        names = [_called(p) for p in records]
        self.coordinates = tuple(Coordinate(name, STEP) for name in names)  # type: ignore[misc]
        self.parameters = tuple(Parameter(name, "s", (-1.0, 1.0), (1e-5, 1e-3)) for name in names)  # type: ignore[misc]

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        time = np.zeros((len(along), 1))
        time[self._records, 0] = [at[_called(p)] for p in self._records.tolist()]
        return np.asarray(along * np.exp(2j * math.pi * frequency * time))


class TurnClock(Effect):
    """A turntable run is recorded by a clock that is not the encoder's."""

    name = "recorder_clock"
    stage = "dynamics"
    title = "instants of a recorder of its own"
    equation = "H = exp(−j·2π·f·time)"
    places = ("turntable",)
    coordinates = (Coordinate("time", STEP),)
    parameters = (Parameter("time", "s", (-1.0, 1.0), (1e-5, 1e-3)),)
    missing = "a lag of all channels behind the encoder, while the rate changes"
    separate_by = "sensor and encoder in one record"
    source = "fit of the cube's clock, latency of its line"

    def response(self, frequency: Array, at: Values) -> Complexes:
        return np.asarray(np.exp(-2j * math.pi * frequency * at["time"]))


def of_sines(part: str, records: Sequence[int], u_time: float) -> Term:
    """Instants of these records of a sweep, each within `u_time`, s."""
    effect = SineClock(part, records)
    zero = dict.fromkeys((one.name for one in effect.coordinates), 0.0)
    return Term(effect, None, zero, dict.fromkeys(zero, u_time))


def of_turns(u_time: float) -> Term:
    """Instants of all records of turntable runs, within `u_time`, s."""
    return Term(TurnClock(), None, {"time": 0.0}, {"time": u_time})


def _called(record: int) -> str:
    return f"time_{record}"
