"""A hidden effect is added to a model, which is turned round: what it makes of the raw records of a sweep is nearer to
the reference than what the data sheet makes of them."""

from __future__ import annotations

from functools import lru_cache

import fast_bench
import numpy as np
import pytest

from rig import Model
from rig.archive.records import Recorded
from rig.motion import ORDERS, Array
from rig.parts.sweep import Sweep
from rig.repair.correction import zero_of
from rig.repair.model_file import ChannelEntry, Value

HIDDEN = {"name": "cubic", "parameters": {"quantity": "acceleration", "coefficient": 3e-4}}
SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 8}
CHANNEL = "unit_a_x"


@lru_cache(maxsize=1)
def records() -> Recorded:
    return fast_bench.measure(SWEEP, fast_bench.world(5, [HIDDEN]))


@lru_cache(maxsize=1)
def model() -> Model:
    return Model(records()).add("cubic")


def part() -> Sweep:
    one = model().fit.parts[0]
    assert isinstance(one, Sweep)
    return one


def reference(point: int, volts: Array, instants: Array) -> Array:
    """True acceleration at these instants, m/s², in the record's time, which the channel's own line tells."""
    sines = part()
    frequency, row = float(sines.data.frequency[point]), sines.channels.names.index(CHANNEL)
    waves = np.exp(2j * np.pi * frequency * np.outer(instants, np.arange(ORDERS)))
    lines = np.linalg.lstsq(np.concatenate([waves.real, waves[:, 1:].imag], axis=1), volts)[0]
    own = lines[1] - 1j * lines[ORDERS]
    late = np.angle(own / sines.data.observed[row, point, 1])
    along = sines.moved(model().fit.state.terms).along[point]
    return np.asarray((waves * along * np.exp(1j * late * np.arange(ORDERS))).real.sum(axis=1))


def errors(point: int) -> tuple[float, float]:
    """Rms error of the data sheet's conversion and of the repaired model, m/s²."""
    index = int(part().data.index[point])
    samples = records().samples(records().points[index]["samples"])
    volts, instants = samples.volts(CHANNEL), samples.instants(CHANNEL)
    true = reference(point, volts, instants)
    nominal = float(part().channels.sensitivity[part().channels.names.index(CHANNEL)])
    plain = (volts - model().correction.channels[0].zero) / nominal
    found = model().apply({CHANNEL: volts}, rate=samples.timing.scan_rate)[CHANNEL]
    middle = slice(100, -100)
    return tuple(float(np.sqrt(np.mean((one - true)[middle] ** 2))) for one in (plain, found))  # type: ignore[return-value]


def test_the_repaired_model_brings_raw_records_nearer_to_the_reference_at_every_point() -> None:
    points = np.flatnonzero(part().data.index >= 0)
    before, after = np.array([errors(int(point)) for point in points]).T
    assert (after < 1.05 * before).all()  # at the lowest level and frequency both are noise
    assert np.sqrt(np.mean(after**2)) < 0.2 * np.sqrt(np.mean(before**2))


def test_the_file_keeps_axis_and_triad_and_what_each_zero_is_known_to() -> None:
    entry = model().file.channels[CHANNEL]
    assert (entry.axis, entry.triad, entry.slot) == ("x", "unit_a", 1)
    assert entry.u_zero.keys() == entry.zero.keys()
    assert model().correction.names == part().channels.names


def test_zeros_of_several_records_are_weighted_and_their_scatter_widens_the_uncertainty() -> None:
    sensitivity = Value(value=1.0, unit="V/(m/s²)")
    agreeing = ChannelEntry(sensitivity=sensitivity, zero={"a": 1.0, "b": 1.003}, u_zero={"a": 0.003, "b": 0.004})
    assert zero_of(agreeing) == (pytest.approx(1.00108), pytest.approx(0.0024))
    apart = agreeing.model_copy(update={"zero": {"a": 1.0, "b": 1.05}})
    assert zero_of(apart) == (pytest.approx(1.018), pytest.approx(0.024))
    assert zero_of(agreeing.model_copy(update={"u_zero": {}})) == (1.003, None)
