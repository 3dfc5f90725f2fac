"""Faults planted in clean records, of a wanted strength: what goes wrong with samples and not with a sensor.

A fault's strength is d′ = √Σ(Δ/σ)² over the rows that it changes: Δ is the change of the device's output that it makes
or that it feigns, σ the noise of a sample of the clean record. Everything follows from the seed. A fault that cannot be
as strong as wanted in a record is as strong as it can be, and says how strong that is.

- glitch: one to five samples stand out, all alike, up or down;
- stuck: the output holds its value for a while;
- clipping: the output stops at a level, above or below;
- reference_step: the reference jumps at one instant and stays there; the device seems to have jumped the other way;
- drift: the output strays in proportion to the time since the record began;
- gain_step: from one instant on the output answers the motion with another gain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from fast_bench import MemoryRecords
from numpy.typing import NDArray

Array = NDArray[np.float64]
KINDS = ("glitch", "stuck", "clipping", "reference_step", "drift", "gain_step")
MOST_GLITCHES, HALVINGS = 5, 60
LOW, STEP = -10.0, 20.0 / 65535.0  # V, of the converter's codes
REFERENCES = ("ldv",)  # that are read in volts; an encoder has no step but lost lines
SENSORS = ("unit", "gyro", "backup")
MOVING = 5.0  # standard deviations of a channel at rest


@dataclass(frozen=True)
class Record:
    """One channel as others would hand it in: `time` s, `reference` and `device` in units of their own, all (n,).

    `noise` is the standard deviation of a sample of the device, `gain` device per reference, `zero` the device's output
    without motion.
    """

    time: Array
    reference: Array
    device: Array
    noise: float
    gain: float = 1.0
    zero: float = 0.0


@dataclass(frozen=True)
class Fault:
    """What was planted: the rows from `first` up to `last`, its `size` in the unit of what it changes, and its d′.

    `size` is the height of glitches and of a step, the level of clipping, the drift at the end, a relative gain; of a
    stuck output its rows. `block` and `channel` say where in a run.
    """

    kind: str
    first: int
    last: int
    size: float
    d_prime: float
    block: str = ""
    channel: str = ""


def planted(clean: Record, kind: str, wanted: float, seed: int) -> tuple[Record, Fault]:
    """The record with a fault in it, and the fault. Raises ValueError for a kind that the record cannot have."""
    if kind not in KINDS:
        raise ValueError(f"fault: found {kind!r}, wanted one of {', '.join(KINDS)}")
    random = np.random.default_rng([seed, KINDS.index(kind)])
    faulty, size = MAKERS[kind](clean, wanted, random)
    feigned = faulty.device - clean.device - clean.gain * (faulty.reference - clean.reference)
    rows = np.flatnonzero(feigned)
    if not len(rows):
        raise ValueError(f"fault: found no sample that {kind} changes, wanted a record with motion")
    strength = float(np.linalg.norm(feigned)) / clean.noise
    return faulty, Fault(kind, int(rows[0]), int(rows[-1]) + 1, size, strength)


def _glitch(clean: Record, wanted: float, random: np.random.Generator) -> tuple[Record, float]:
    count = int(random.integers(1, MOST_GLITCHES + 1))
    rows = random.choice(len(clean.time), count, replace=False)
    height = wanted * clean.noise / math.sqrt(count) * random.choice([-1.0, 1.0])
    device = clean.device.copy()
    device[rows] += height
    return replace(clean, device=device), float(height)


def _stuck(clean: Record, wanted: float, random: np.random.Generator) -> tuple[Record, float]:
    first = _inside(clean, random)
    away = np.cumsum((clean.device[first:] - clean.device[first]) ** 2)
    rows = int(np.searchsorted(away, (wanted * clean.noise) ** 2)) + 1
    device = clean.device.copy()
    device[first : first + rows] = device[first]
    return replace(clean, device=device), float(min(rows, len(device) - first))


def _clipping(clean: Record, wanted: float, random: np.random.Generator) -> tuple[Record, float]:
    sign = float(random.choice([-1.0, 1.0]))
    up = sign * clean.device
    low, high = float(up.min()), float(up.max())
    for _ in range(HALVINGS):
        level = 0.5 * (low + high)
        strength = float(np.linalg.norm(np.maximum(up - level, 0.0))) / clean.noise
        low, high = (low, level) if strength < wanted else (level, high)
    return replace(clean, device=sign * np.minimum(up, high)), sign * high


def _reference_step(clean: Record, wanted: float, random: np.random.Generator) -> tuple[Record, float]:
    first = _inside(clean, random)
    height = wanted * clean.noise / (abs(clean.gain) * math.sqrt(len(clean.time) - first)) * random.choice([-1.0, 1.0])
    reference = clean.reference.copy()
    reference[first:] += height
    return replace(clean, reference=reference), float(height)


def _drift(clean: Record, wanted: float, random: np.random.Generator) -> tuple[Record, float]:
    share = (clean.time - clean.time[0]) / (clean.time[-1] - clean.time[0])
    size = wanted * clean.noise / float(np.linalg.norm(share)) * random.choice([-1.0, 1.0])
    return replace(clean, device=clean.device + size * share), float(size)


def _gain_step(clean: Record, wanted: float, random: np.random.Generator) -> tuple[Record, float]:
    first = _inside(clean, random)
    signal = np.where(np.arange(len(clean.time)) < first, 0.0, clean.device - clean.zero)
    moving = float(np.linalg.norm(np.where(signal == 0.0, 0.0, clean.gain * clean.reference)))
    if moving <= MOVING * clean.noise:
        raise ValueError("fault: found a record at rest, wanted one with motion for a gain_step")
    size = wanted * clean.noise / float(np.linalg.norm(signal)) * random.choice([-1.0, 1.0])
    return replace(clean, device=clean.device + size * signal), float(size)


def _inside(clean: Record, random: np.random.Generator) -> int:
    """A row in the middle half."""
    count = len(clean.time)
    return int(random.integers(count // 4, 3 * count // 4))


MAKERS: Mapping[str, Callable[[Record, float, np.random.Generator], tuple[Record, float]]] = {
    "glitch": _glitch, "stuck": _stuck, "clipping": _clipping, "reference_step": _reference_step, "drift": _drift,
    "gain_step": _gain_step,
}  # fmt: skip


def planted_in_run(clean: MemoryRecords, kind: str, wanted: float, seed: int) -> tuple[MemoryRecords, Fault]:
    """A run with a fault in one channel of one of its records, and the fault; the clean run stays as it is.

    Noise is that of the channel in the run's first record, which is at rest. Changes come in whole codes, so that a
    faint fault may be stronger or weaker than wanted, and says so. Raises ValueError as `planted` does, and where no
    record of the run can have such a fault.
    """
    random = np.random.default_rng([seed, len(KINDS)])
    block, column, record = _chosen(clean, kind, random)
    faulty, fault = planted(record, kind, wanted, seed)
    counts = clean.block(block).copy()
    changed = faulty.reference if kind == "reference_step" else faulty.device
    counts[:, column] = np.clip(np.rint((changed - LOW) / STEP), 0, 65535)
    moved = counts[:, column].astype(np.float64) - clean.block(block)[:, column]
    run = replace(clean, arrays={**clean.arrays, block: [counts]})
    channel = str(clean.metas[block]["channels"][column][0])
    strength = float(np.linalg.norm(moved)) * STEP / record.noise
    return run, replace(fault, block=block, channel=channel, d_prime=strength)


def _chosen(clean: MemoryRecords, kind: str, random: np.random.Generator) -> tuple[str, int, Record]:
    """A block, a column of it, and their record: a reference for its step, else a sensor that moves if it has to."""
    names = [name for name, meta in clean.metas.items() if "convert_period" in meta]
    still, wanted = _volts(clean, names[0]), REFERENCES if kind == "reference_step" else SENSORS
    noise = still.std(axis=0)
    for block in random.permutation(names[1:]).tolist():
        here, meta = _volts(clean, block), clean.metas[block]
        moves = (here.std(axis=0) > MOVING * noise) | (kind not in ("clipping", "gain_step"))
        columns = [n for n, channel in enumerate(meta["channels"]) if channel[0].startswith(wanted) and moves[n]]
        if columns:
            column = int(random.choice(columns))
            signal, zero = here[:, column], float(still[:, column].mean())
            time = np.arange(len(here)) * float(meta["convert_period"]) * len(meta["channels"])
            reference = signal if kind == "reference_step" else signal - zero
            return block, column, Record(time, reference, signal, float(noise[column]), 1.0, zero)
    raise ValueError(f"fault: found no channel for {kind}, wanted one of {', '.join(wanted)} in some record")


def _volts(records: MemoryRecords, block: str) -> Array:
    """Volts of all channels, (scans, channels)."""
    return np.asarray(LOW + records.block(block).astype(np.float64) * STEP)


def sealed(fault: Fault) -> dict[str, Any]:
    """The fault as an answer holds it."""
    return dict(vars(fault))
