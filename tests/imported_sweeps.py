"""Imported sweeps for tests: sines that two accelerometers saw, made here, or the real shaker's files."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.foreign.manifest import Manifest
from rig.foreign.tables import Foreign, Table

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
DRIVE, INTERVAL, SAMPLES, MAINS = 5.172, 0.000586, 12_375, 60.0
LEVELS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
NOISE = 3e-4
HERE = Path(__file__).parent
REAL = Path(os.environ.get("RIG_REAL_DATA", str(HERE.parents[1] / "shared" / "data"))) / "artslab-shaker-pcb"


def manifest(files: Sequence[str], columns: Sequence[Mapping[str, Any]], **changed: Any) -> Manifest:
    """A sweep's manifest."""
    stated: dict[str, Any] = {
        "format": 1, "kind": "sweep", "unit": {"serial": "board"},
        "provenance": {"source": "made for a test", "licence": "none"}, "files": [{"path": one} for one in files],
        "time": {"interval": f"{INTERVAL * 1e3} ms"}, "mains": f"{MAINS:g} Hz", "columns": list(columns), **changed,
    }  # fmt: skip
    return Manifest.model_validate(stated)


def columns(unit: str = "", **device: Any) -> list[dict[str, Any]]:
    """Drive, base (the reference) and board (the device)."""
    quantity = "acceleration" if unit else "unstated"
    return [
        {"column": "drive", "quantity": "voltage", "unit": "V", "role": "drive"},
        {"column": "base", "quantity": quantity, "unit": unit, "role": "reference"},
        {"column": "board", "quantity": quantity, "unit": unit, "axis": "z", **device},
    ]


def waveform(t: Array, frequency: float, harmonics: Sequence[complex]) -> Array:
    """Sum of Re(C_k·exp(2πjkft)), k = 1 …"""
    return np.asarray(sum((c * np.exp(2j * np.pi * k * frequency * t)).real for k, c in enumerate(harmonics, 1)))


def pure(level: float) -> list[complex]:
    """A shaker without distortion."""
    return [0.57 * level]


def distorted(level: float) -> list[complex]:
    """A shaker with harmonics that grow with the level, and compression."""
    first = 0.6 * level * (1.0 - 0.1 * level**2)
    return [first, 0.2j * first * level, -0.3 * first * level**2, 0.1 * first * level, 0.05j * first]


def made(
    *, shaker: Callable[[float], Sequence[complex]] = pure, board: Callable[[Array], Array] = lambda a: 0.963 * a,
    drive: float = DRIVE, mains: float = MAINS, hum: float = 2e-3, late: float = 0.0, rattle: float = 0.0,
    levels: Sequence[float] = LEVELS, columns_: Sequence[Mapping[str, Any]] | None = None, seed: int = 1,
    **changed: Any,
) -> Foreign:  # fmt: skip
    """Files of a shaker at several levels and one at rest; `board` makes the board's numbers of the base's motion.

    `late` s: how much later the board is sampled. `rattle`: real motion between the lines, over the fundamental.
    """
    random = np.random.default_rng(seed)
    t = np.asarray(INTERVAL * np.arange(SAMPLES), np.float64)
    tables = []
    for number, level in enumerate((0.0, *levels)):
        shaking = np.cumsum(random.normal(size=SAMPLES + 1))
        shaking = rattle * level * 0.1 * (shaking - shaking.mean()) / shaking.std()
        harmonics = list(shaker(level)) if level else [0.0]
        motion = waveform(t, drive, harmonics) + shaking[:-1]
        moved = waveform(t + late, drive, harmonics) + np.interp(t + late, t, shaking[:-1])
        noise = random.normal(size=(3, SAMPLES)) * NOISE
        lines = hum * (waveform(t, 2.0 * mains, [1.0]) + waveform(t, 4.0 * mains, [1j]))
        rows = [waveform(t, drive, [level]) + 0.1 * noise[0], motion + 0.06 + lines + noise[1],
                board(moved) - 0.013 + 1.5 * lines + noise[2]]  # fmt: skip
        settings: dict[str, str | float] = {"frequency": "5 Hz", "command": level} if level else {"level": "rest"}
        tables.append(Table(f"file {number}", ("drive", "base", "board"), np.stack(rows, axis=1), settings, False))
    return Foreign("made", manifest([one.label for one in tables], columns_ or columns(), **changed), tuple(tables), ())


def real(pattern: str = "amplitude_5_impact_0.0_*.csv", unit: str = "") -> Foreign:
    """The real shaker's files as they stand; skips without them."""
    files = sorted(REAL.glob(pattern))
    if not files:
        pytest.skip(f"no {pattern} in {REAL}: set RIG_REAL_DATA to the folder of the real data")
    tables = []
    for path in files:
        amplifier, command = (
            float(one) for one in re.findall(r"amplitude_(\d+)_.*vibration_([\d.]+)\.csv", path.name)[0]
        )
        values = np.loadtxt(path, delimiter=",", skiprows=2)
        driven: dict[str, str | float] = {"frequency": "5 Hz", "amplifier": amplifier, "command": command}
        settings = driven if command else {"level": "rest"}
        tables.append(Table(path.stem, ("drive", "base", "board"), values, settings, False))
    return Foreign("artslab", manifest([one.name for one in files], columns(unit)), tuple(tables), ())
