"""Of a rotation without rest or data sheet the noise is known where its band above the motion shows nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from blind_imports import Record, evidence
from numpy.typing import NDArray

from rig.diagnose.diagnose import diagnose
from rig.foreign.tables import Foreign
from rig.parts.reading.imported import parts_of
from rig.parts.track import TrackedMotion
from rig.shelf import shelf

Array = NDArray[np.float64]
Change = Callable[[Array, float, np.random.Generator, Array], Array]
ROWS = 100.0  # per second
TRUE = {"gyro": 2e-3, "acc_": 0.02}  # standard deviation of a sample, rad/s and m/s²


def record(seed: int = 930000) -> Foreign:
    return Record("rotation", seed, known=False).made()


def changed(made: Foreign, change: Change) -> Foreign:
    """The record with something more in all channels of the device."""
    (table,) = made.tables
    values, random = table.values.copy(), np.random.default_rng(3)
    common = random.normal(size=len(values))
    for k, name in enumerate(table.names):
        if name[:4] in TRUE:
            values[:, k] = change(values[:, k], TRUE[name[:4]], random, common)
    return replace(made, tables=(replace(table, values=values),))


def flicker(values: Array, sigma: float, random: np.random.Generator, common: Array) -> Array:
    """Noise as strong as the white at 3 Hz."""
    f = np.fft.rfftfreq(len(values), 1.0 / ROWS)
    shape = np.sqrt(3.0 / np.maximum(f, f[1])) * (f > 0.0)
    return np.asarray(values + sigma * np.fft.irfft(np.fft.rfft(random.normal(size=len(values))) * shape, len(values)))


def low_passed(values: Array, sigma: float, random: np.random.Generator, common: Array) -> Array:
    """As by a filter of 12 Hz."""
    from scipy.signal import lfilter

    keep = math.exp(-2.0 * math.pi * 12.0 / ROWS)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values))


UNKNOWN: dict[str, Change] = {
    "a line": lambda v, s, r, c: v + 1.5 * s * np.sin(2.0 * np.pi * 17.3 / ROWS * np.arange(len(v))),
    "vibration that all channels share": lambda v, s, r, c: v + 1.5 * s * c,
    "coarse codes": lambda v, s, r, c: np.round(v / (6.0 * s)) * 6.0 * s,
    "noise that rises": lambda v, s, r, c: v + 2.0 * s * np.diff(r.normal(size=len(v) + 1)),
    "flicker": flicker,
    "a filter": low_passed,
}


def part(made: Foreign) -> TrackedMotion:
    (found,) = parts_of(made)[0]
    assert isinstance(found, TrackedMotion)
    return found


def test_the_noise_of_a_record_that_never_rests_is_known_within_a_tenth_and_a_true_model_of_it_is_adequate() -> None:
    found = part(record())
    assert {found.origin(name) for name in found.row_names} == {"above the motion"}
    for row, name in enumerate(found.row_names):
        known = found.known(row)
        assert known is not None
        sigma = math.sqrt(float(known.model.density(np.array([1.0]))[0]) * 0.5 * ROWS)
        if name != "gyro_z":  # about the axis the jitter of the stamps is in it too
            assert sigma == pytest.approx(TRUE[name[:4]], rel=0.1)
    assert diagnose(evidence(record()), shelf=shelf()).verdict == "adequate"


@pytest.mark.parametrize("kind", UNKNOWN)
def test_where_the_band_above_the_motion_shows_anything_else_the_noise_stays_unknown(kind: str) -> None:
    found = part(changed(record(), UNKNOWN[kind]))
    assert {found.origin(name) for name in found.row_names} == {"misfit"}
