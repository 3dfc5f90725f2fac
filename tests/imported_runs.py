"""Imported data made in memory as sealed runs, and poses against gravity that somebody might have recorded."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from imported_worlds import manifest
from numpy.typing import NDArray

from rig.archive.runs import Runs
from rig.foreign.importing import File, Read, keep
from rig.foreign.manifest import as_json
from rig.foreign.tables import Foreign, Table

Array = NDArray[np.float64]
G = 9.80665
STANDARD = {"name": "pendulum", "certificate": "PTB-7", "laboratory": "PTB", "due": "2027-01-01"}


def kept(foreign: Foreign, runs: Path, **changed: Any) -> str:
    """A sealed run of it; `changed` keys of its manifest. Returns the run's name."""
    made = foreign.manifest.model_copy(update=changed)
    text = yaml.safe_dump(as_json(made), allow_unicode=True).encode()
    files = [
        File(source, hashlib.sha256(table.values.tobytes()).hexdigest(), table.values.nbytes, table)
        for source, table in zip(made.files, foreign.tables, strict=True)
    ]
    return keep(Read(Path("manifest.yaml"), text, made, tuple(files), ()), Runs(runs))


def posed(
    seed: int, *, gain: Array, zero: Array, angles: tuple[float, float, float] = (0.0, 0.0, 0.0), poses: int = 24,
    noise: float = 0.01, counts: float = 100.0,
) -> Foreign:  # fmt: skip
    """A triad held in attitudes all over the sphere, in counts; `angles` yz, zy, zx as published, rad."""
    random = np.random.default_rng(seed)
    up = random.normal(size=(3, poses))
    up /= np.linalg.norm(up, axis=0)
    yz, zy, zx = angles
    shown = np.linalg.solve(np.array([[1.0, -yz, zy], [0.0, 1.0, -zx], [0.0, 0.0, 1.0]]), G * up)
    still = np.repeat(gain[:, None] * shown + zero[:, None], 200, axis=1)
    values = counts * (still + noise * random.normal(size=still.shape))
    columns = [
        {"column": f"acc_{a}", "quantity": "acceleration", "sensitivity": f"{counts:g} counts per m/s²", "axis": a,
         "tolerance": "5 %"}
        for a in "xyz"
    ]  # fmt: skip
    segments = [{"first": 200 * k, "last": 200 * (k + 1)} for k in range(poses)]
    made = manifest(
        "poses", columns, [{"path": "poses.csv"}], time={"rate": "100 Hz"}, segments=segments,
        gravity={"value": f"{G} m/s²", "uncertainty": "0.0005 m/s²"},
    )  # fmt: skip
    names = tuple(f"acc_{a}" for a in "xyz")
    return Foreign("made", made, (Table("poses", names, values.T, {}, False),), ())


def rested(
    seed: int,
    *,
    force: float,
    rate: float,
    walk: float = 0.0,
    rows: int = 20_000,
    tolerance: str = "",
) -> Foreign:
    """A unit at rest with z up at 100 Hz: white noise of density `force` (m/s²)/√Hz and `rate` (rad/s)/√Hz (two-sided
    roots, N), and in the rates a random walk of `walk` (rad/s)·√Hz (K)."""
    random = np.random.default_rng(seed)
    density = np.array([force] * 3 + [rate] * 3)
    values = density * np.sqrt(100.0) * random.normal(size=(rows, 6))
    values[:, 3:] += np.cumsum(walk / np.sqrt(100.0) * random.normal(size=(rows, 3)), axis=0)
    values[:, 2] += G
    more = {"tolerance": tolerance} if tolerance else {}
    columns = [
        *({"column": f"acc_{a}", "quantity": "acceleration", "unit": "m/s²", "axis": a, **more} for a in "xyz"),
        *({"column": f"gyro_{a}", "quantity": "rate", "unit": "rad/s", "axis": a, **more} for a in "xyz"),
    ]  # fmt: skip
    made = manifest("static", columns, [{"path": "still.csv"}], time={"rate": "100 Hz"})
    return Foreign("made", made, (Table("still", tuple(one["column"] for one in columns), values, {}, False),), ())
