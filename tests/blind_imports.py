"""Imported records of the blind test: what somebody else might have measured, with something hidden, or faults in it.

A record is drawn from a case's seed alone: its motion, its unit, how well its reference is known. d′ is what can be
detected: what is hidden changes the device's numbers by Δ; of that all is taken away which a gain and a zero of each
channel can take up, and the rest is counted against the noise of device and reference together, in the lines that
their motion has. Faults of single samples are counted as `faults` does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import blind_laws
import faults
import imported_sweeps
import imported_worlds
import numpy as np
from blind_laws import Law, hiding, sized
from imported_runs import posed
from imported_worlds import FREQUENCIES, SHOWN, Unit, clean, motion, response, response_table, rotation
from numpy.typing import NDArray

from rig.fit.evidence import Evidence
from rig.foreign.tables import Foreign, Table
from rig.parts.reading import imported

Array = NDArray[np.float64]
KINDS = ("rotation", "sweep", "motion", "poses", "response")
UNKNOWN = ("rotation", "motion")  # of these nothing but a rest or a data sheet tells the noise
UNDECIDED = "motion"  # cameras add an unknown noise while the body moves, whatever a rest shows
FAULTS: Mapping[str, tuple[str, ...]] = {
    "rotation": faults.KINDS, "sweep": faults.KINDS, "motion": faults.KINDS,
    "poses": ("glitch", "stuck", "clipping", "drift", "gain_step"),
    "response": ("glitch", "drift", "gain_step"),
}  # fmt: skip
SMOOTH = ("drift", "gain_step")
BAND = 4.0  # Hz, up to which d′ counts
ROWS = 100.0  # per second
REST = 10.0  # s
STEPS = math.radians(360.0 / 4096)
PLACE, TURN = 2e-4, 1e-3  # m, rad: cameras
REPEATS, SCATTER, STATED = 3, 1e-3, 1e-3  # of responses
HELD, STILL, COUNTS = 200, 0.01, 100.0  # rows of a pose, noise (m/s²), counts per m/s²
HALVINGS = 16
LEVELS = ((0.3, 0.6, 1.0), (0.2, 0.7, 1.0))  # of a sweep's two frequencies
DRIVES = (imported_sweeps.DRIVE, 17.31)  # Hz
TABLES = (3.0, 15.0)  # m/s², of a response's two tables


@dataclass(frozen=True)
class Record:
    """A record to come: kind and seed, what is hidden, and whether anything tells the noise of the device."""

    kind: str
    seed: int
    law: Law | None = None
    at: Mapping[str, Any] | None = None
    known: bool = True

    def made(self) -> Foreign:
        """As it is imported."""
        return MAKERS[self.kind](self)

    @property
    def unit(self) -> Unit:
        plain = clean(self.seed)
        return plain if self.law is None or self.at is None else hiding(plain, self.law, self.at)

    @property
    def random(self) -> np.random.Generator:
        """Draws of the record's circumstances, the same whatever is hidden."""
        return np.random.default_rng([self.seed, 11])

    @property
    def quantities(self) -> tuple[str, ...]:
        """Of the device's channels."""
        if self.kind == "rotation":
            return ("rate",) if _circumstances(self)[0] else ("rate", "acceleration")
        return ("rate", "acceleration") if self.kind == "motion" else ("acceleration",)

    def with_size(self, size: float) -> Record:
        assert self.at is not None
        return replace(self, at=sized(self.at, size))

    def without(self) -> Record:
        return replace(self, law=None, at=None)


def evidence(record: Foreign) -> Evidence:
    """What a model is compared with, as the program reads it of an imported run."""
    made = imported_worlds.evidence(record)
    return replace(made, imported=True, twice=lambda: imported.twice([record], made.parts))


# records


def _rotation(one: Record) -> Foreign:
    upright, lies, jitter, by_sheet = _circumstances(one)
    sheet = {"density": f"{2e-3 * math.sqrt(2.0 / ROWS)} (rad/s)/√Hz", "tolerance": "20 %"}
    disk = one.law.shown if one.law is not None and one.at is not None else None
    return rotation(
        one.unit, one.seed, upright=upright, lies=lies, jitter=jitter, rest=REST * (one.known and not by_sheet),
        band=None, channels="r" if upright else "rf", sheet=sheet if one.known and by_sheet else None, rows=ROWS,
        steps=STEPS, disk=None if disk is None else lambda angle: disk(angle, one.at or {}),
    )  # fmt: skip


def _circumstances(one: Record) -> tuple[bool, float, float, bool]:
    """Of a rotation: upright or level, how gravity lies (rad), jitter of the stamps (s), and whether noise is known by
    the data sheet (of gyros alone) and not at rest.
    """
    random = one.random
    upright, lies, jitter = random.uniform() < 0.5, random.uniform(0.0, 6.0), 10.0 ** random.uniform(-4.0, -3.0)
    return bool(upright), float(lies), float(jitter), bool(upright and random.uniform() < 0.5)


def _motion(one: Record) -> Foreign:
    return motion(one.unit, one.seed, rows=ROWS, bands=(None, None), place_noise=PLACE, turn_noise=TURN)


def _sweep(one: Record) -> Foreign:
    gain, late = 0.963, 0.0
    board: Callable[[Array], Array] = lambda a: gain * a  # noqa: E731
    if one.law is not None and one.at is not None:
        if one.law.name == "delay":
            late = -float(one.at["size"])
        else:
            law, at = one.law, one.at
            board = lambda a: gain * _felt(law, at, a)  # noqa: E731
    shaker = imported_sweeps.distorted if one.random.uniform() < 0.5 else imported_sweeps.pure
    found = [
        imported_sweeps.made(shaker=shaker, board=board, drive=drive, late=late, levels=levels, seed=one.seed + n)
        for n, (drive, levels) in enumerate(zip(DRIVES, LEVELS, strict=True))
    ]  # fmt: skip
    tables = [*found[0].tables, *found[1].tables[1:]]
    named = [replace(table, label=f"file {n}") for n, table in enumerate(tables)]
    for n in range(1, len(named)):
        drive = DRIVES[n > len(LEVELS[0])]
        named[n] = replace(named[n], settings={**named[n].settings, "frequency": f"{drive:g} Hz"})
    made = imported_sweeps.manifest([one.label for one in named], imported_sweeps.columns())
    return replace(found[0], manifest=made, tables=tuple(named))


def _felt(law: Law, at: Mapping[str, Any], values: Array) -> Array:
    """What a law that knows no time makes of values."""
    assert law.acts is not None
    return law.acts((lambda t: values, lambda t: values), at, "acceleration")[1](np.zeros(1))


def _poses(one: Record) -> Foreign:
    unit = clean(one.seed)
    made = posed(one.seed, gain=np.ones(3), zero=np.zeros(3), poses=48, noise=STILL)
    (table,) = made.tables
    felt = table.values.T / COUNTS
    if one.law is not None and one.at is not None:
        felt = _felt(one.law, one.at, felt)
    values = COUNTS * (np.asarray(unit.force_gain)[:, None] * felt + np.asarray(unit.force_zero)[:, None])
    return replace(made, tables=(replace(table, values=values.T),))


def _response(one: Record) -> Foreign:
    gain = 1.0 + 0.01 * float(one.random.normal())
    tables = [
        response_table(
            _phasor(one, gain, level), one.seed + n, level=level, repeats=REPEATS, scatter=SCATTER, stated=STATED
        )
        for n, level in enumerate(TABLES)
    ]  # fmt: skip
    return response(tables)


def _phasor(one: Record, gain: float, level: float) -> Callable[[float], complex]:
    def phasor(frequency: float) -> complex:
        if one.law is None or one.at is None:
            return complex(gain)
        if one.law.response is not None:
            return complex(gain * one.law.response(np.array([frequency]), one.at)[0])
        assert one.law.acts is not None
        t = np.arange(64) / 64.0 / frequency

        def moved(at: Array) -> Array:
            return np.asarray(level * np.cos(2.0 * math.pi * frequency * at))

        shown = one.law.acts((moved, moved), one.at, "acceleration")[1](t)
        return complex(gain * 2.0 * np.mean(shown * np.exp(-2j * math.pi * frequency * t)) / level)

    return phasor


MAKERS: Mapping[str, Callable[[Record], Foreign]] = {
    "rotation": _rotation, "sweep": _sweep, "motion": _motion, "poses": _poses, "response": _response,
}  # fmt: skip


# strengths


def detected(one: Record, hidden: Foreign, plain: Foreign) -> float:
    """d′ of a record's difference from the same record without."""
    return float(np.linalg.norm(_whitened(one, hidden, plain)))


def _whitened(one: Record, hidden: Foreign, plain: Foreign) -> Array:
    """That difference in units of the noise, without what gains and zeros take up."""
    return WHITENED[one.kind](one, hidden, plain)


def _beside(columns: Array, delta: Array) -> Array:
    """What is left of whitened rows (n,) once columns (n, k) have taken up what they can."""
    basis, _ = np.linalg.qr(columns)
    return np.asarray(delta - basis @ (basis.T @ delta))


def _left(columns: Array, delta: Array) -> float:
    return float(np.linalg.norm(_beside(columns, delta)))


def _of_track(one: Record, hidden: Foreign, plain: Foreign) -> Array:
    from scipy.fft import dct

    before, after = plain.tables[0], hidden.tables[0]
    n = len(before.values)
    f = np.arange(n) * ROWS / (2.0 * n)
    use, rows = f < BAND, []
    rate, force = _reference_noise(one, before, f)
    for name in SHOWN:
        delta = after.of(name) - before.of(name)
        moving = name.startswith("gyro") and one.kind == "rotation" and np.std(before.of(name)) > 0.1
        if moving and "angle" in before.names:
            turned = np.unwrap(after.of("angle")) - np.unwrap(before.of("angle"))
            if one.law is not None and one.law.shown is not None and one.at is not None:  # without codes
                turned = one.law.shown(before.of("angle"), one.at) - before.of("angle")
            delta = delta - np.gradient(turned, 1.0 / ROWS)
        noise = np.hypot(*((2e-3, rate) if name.startswith("gyro") else (0.02, force)))[use]
        columns = np.stack([dct(x, norm="ortho")[use] / noise for x in (before.of(name), np.ones(n))], axis=1)
        rows.append(_beside(columns, dct(delta, norm="ortho")[use] / noise))
    return np.concatenate(rows)


def _reference_noise(one: Record, table: Table, f: Array) -> tuple[Array, Array]:
    """Of the reference's rate (rad/s) and force (m/s²), by lines of the cosine transform."""
    omega = 2.0 * math.pi * f
    if one.kind == "rotation":
        jitter = _circumstances(one)[2]
        rates = [float(np.std(table.of(name))) for name in SHOWN[:3]]
        theta = math.hypot(jitter * max(rates), STEPS / math.sqrt(12.0))
        return theta * omega, 9.8 * theta * np.ones_like(f)
    return TURN * omega, np.hypot(PLACE * omega**2, 9.8 * TURN)


def _of_sweep(one: Record, hidden: Foreign, plain: Foreign) -> Array:
    noise = imported_sweeps.NOISE * math.hypot(1.0, 0.963)
    delta, motion_ = [], []
    for before, after, drive in zip(
        plain.tables, hidden.tables, (0.0, *[DRIVES[0]] * 3, *[DRIVES[1]] * 3), strict=True
    ):
        t = np.arange(len(before.values)) * imported_sweeps.INTERVAL
        rows = [np.ones(len(t)) / math.sqrt(len(t))]
        for k in range(1, 6) if drive else ():
            rows += [wave(2.0 * math.pi * k * drive * t) * math.sqrt(2.0 / len(t)) for wave in (np.cos, np.sin)]
        basis = np.stack(rows)
        change = after.of("board") - before.of("board") - 0.963 * (after.of("base") - before.of("base"))
        delta.append(basis @ change / noise)
        motion_.append(basis @ before.of("base") / noise)
    zeros = np.concatenate([np.eye(1, len(one))[0] for one in delta]) * math.sqrt(imported_sweeps.SAMPLES)
    return _beside(np.stack([np.concatenate(motion_), zeros], axis=1), np.concatenate(delta))


def _of_poses(one: Record, hidden: Foreign, plain: Foreign) -> Array:
    before, after = (foreign.tables[0].values.reshape(-1, HELD, 3).mean(axis=1) / COUNTS for foreign in (plain, hidden))
    up = before / np.linalg.norm(before, axis=1)[:, None]
    noise = STILL / math.sqrt(HELD)
    return _beside(np.concatenate([up * before, up], axis=1) / noise, np.sum(up * (after - before), axis=1) / noise)


def _of_response(one: Record, hidden: Foreign, plain: Foreign) -> Array:
    noise, rows, sizes = math.hypot(STATED, SCATTER / math.sqrt(REPEATS)), [], []
    for before, after in zip(plain.tables, hidden.tables, strict=True):
        ratio = _ratio(after) / _ratio(before)
        rows += [np.log(np.abs(ratio)), np.angle(ratio)]
        sizes += [np.ones(len(ratio)), np.zeros(len(ratio))]
    columns = np.concatenate(sizes)[:, None] / noise
    return _beside(columns, np.concatenate(rows) / noise)


def _ratio(table: Table) -> NDArray[np.complex128]:
    """Means over the repeats of every frequency."""
    size, turn = (table.of(name).reshape(REPEATS, len(FREQUENCIES)).mean(axis=0) for name in ("magnitude", "phase"))
    return np.asarray(size * np.exp(1j * turn))


WHITENED: Mapping[str, Callable[[Record, Foreign, Foreign], Array]] = {
    "rotation": _of_track, "sweep": _of_sweep, "motion": _of_track, "poses": _of_poses, "response": _of_response,
}  # fmt: skip


def of_strength(one: Record, wanted: float) -> tuple[Record, float]:
    """The record with a size at which d′ is within 3 % of what is wanted, as far as its range allows, and that d′.

    Of a stranger only that counts which no single effect of the shelf takes up.
    """
    assert one.law is not None
    assert one.at is not None
    low, high = (math.log(end) for end in one.law.size)
    x = 0.5 * (low + high)
    plain, best = one.without().made(), math.nan
    near = _near(one, plain) if one.law.stranger else ()
    for _ in range(HALVINGS):
        there = one.with_size(math.exp(x))
        best = _told(there, there.made(), plain, near)
        if abs(best / wanted - 1.0) < 0.03:
            break
        low, high = (x, high) if best < wanted else (low, x)
        proportional = x + math.log(wanted / max(best, 1e-9))
        x = proportional if low < proportional < high else 0.5 * (low + high)
    return one.with_size(math.exp(x)), best


def _near(one: Record, plain: Foreign) -> list[Array]:
    """What each effect of the shelf that may act on the same channels changes at a small size, in whitened rows."""
    made = []
    for name in blind_laws.names(one.kind):
        law, random = blind_laws.law_of(name), np.random.default_rng([one.seed, 14])
        assert one.at is not None
        at = law.drawn(random, (str(one.at["on"]),) if one.at["on"] in law.on else one.quantities)
        small = replace(one, law=law, at=at)  # the middle of a range is small
        made.append(_whitened(small, small.made(), plain))
    return made


def _told(one: Record, hidden: Foreign, plain: Foreign, near: Sequence[Array]) -> float:
    """d′ beside whichever of these takes up most of it."""
    rows = _whitened(one, hidden, plain)
    return min((_left(column[:, None], rows) for column in near if column.any()), default=float(np.linalg.norm(rows)))


# faults


def with_fault(one: Record, kind: str, wanted: float) -> tuple[Foreign, dict[str, Any]]:
    """The record with a fault of this strength in one of its channels, and what was planted."""
    record, random = one.made(), np.random.default_rng([one.seed, 12])
    number = int(random.integers(1, len(record.tables))) if len(record.tables) > 1 else 0
    if one.kind == "response":
        number = int(random.integers(len(record.tables)))
    table = record.tables[number]
    if kind == "reference_step" and one.kind in ("rotation", "motion"):
        faulty, entry = _slipped(one, table, wanted, random)
    else:
        name, reference, noise, gain, zero = _channel(one, table, kind, random)
        time = np.arange(len(table.values)) / ROWS
        signal = table.of(name)
        clean_one = faults.Record(time, table.of(reference) if reference else signal - zero, signal, noise, gain, zero)
        spoilt, fault = faults.planted(clean_one, kind, wanted, one.seed)
        values = table.values.copy()
        values[:, table.names.index(name)] = spoilt.device
        if reference:
            values[:, table.names.index(reference)] = spoilt.reference
        faulty, entry = replace(table, values=values), {**faults.sealed(fault), "channel": name}
    made = replace(record, tables=tuple(faulty if k == number else t for k, t in enumerate(record.tables)))
    entry["detected"] = detected(one, made, record)
    return made, entry


def _channel(one: Record, table: Table, kind: str, random: np.random.Generator) -> tuple[str, str, float, float, float]:
    """A channel that can have the fault, its reference where that is of the same quantity, noise, gain and zero."""
    if one.kind == "sweep":
        return "board", "base", imported_sweeps.NOISE, 0.963, -0.013
    if one.kind == "response":
        name = str(random.choice(["magnitude", "phase"] if kind != "gain_step" else ["magnitude"]))
        return name, "", math.hypot(STATED, SCATTER), 1.0, 0.0
    if one.kind == "poses":
        return str(random.choice(table.names)), "", COUNTS * STILL, 1.0, 0.0
    shown = [name for name in SHOWN if any(c.column == name for c in one.made().manifest.columns)]
    moving = [name for name in shown if np.std(table.of(name)) > (0.1 if name.startswith("gyro") else 0.3)]
    name = str(random.choice(moving if kind in ("clipping", "gain_step") else shown))
    return name, "", 2e-3 if name.startswith("gyro") else 0.02, 1.0, _zero(one.unit, name)


def _zero(unit: Unit, name: str) -> float:
    return float((*unit.rate_zero, *unit.force_zero)[SHOWN.index(name)])


def _slipped(one: Record, table: Table, wanted: float, random: np.random.Generator) -> tuple[Table, dict[str, Any]]:
    """A reference that jumps, by so many times the noise of its difference from row to row."""
    from scipy.spatial.transform import Rotation

    first = int(random.integers(len(table.values) // 4, 3 * len(table.values) // 4))
    values, sign = table.values.copy(), float(random.choice([-1.0, 1.0]))
    if one.kind == "rotation":
        rate, _ = _reference_noise(one, table, np.array([ROWS / math.pi]))
        size = sign * wanted * math.hypot(2e-3, math.sqrt(0.5) * float(rate[0])) / ROWS
        column = table.names.index("angle")
        values[first:, column] = np.mod(np.round((values[first:, column] + size) / STEPS) * STEPS, 2.0 * math.pi)
    else:
        size = sign * wanted * math.sqrt(2.0) * TURN
        at = [table.names.index(name) for name in ("qx", "qy", "qz", "qw")]
        there = first + np.flatnonzero(np.isfinite(values[first:, at]).all(axis=1))
        axis = random.normal(size=3)
        slip = Rotation.from_rotvec(size * axis / np.linalg.norm(axis))
        values[np.ix_(there, at)] = (Rotation.from_quat(values[np.ix_(there, at)]) * slip).as_quat()
    entry = {"kind": "reference_step", "first": first, "size": size, "d_prime": wanted, "channel": "reference"}
    return replace(table, values=values), entry


def hidden(one: Record, name: str, share: float, ends: tuple[float, float]) -> dict[str, Any]:
    """What is hidden under a name, with a strength this share of the way between the ends, on a logarithmic scale."""
    law, wanted = blind_laws.law_of(name), ends[0] * (ends[1] / ends[0]) ** share
    parameters = law.drawn(np.random.default_rng([one.seed, 13]), one.quantities)
    found, reached = of_strength(replace(one, law=law, at=parameters), wanted)
    return {"name": name, "parameters": dict(found.at or {}), "d_prime": reached}


def names_of(table: str, kind: str) -> Sequence[str]:
    """What may be hidden in records of a kind in a table of the study."""
    if table == "faults":
        return FAULTS[kind]
    return blind_laws.names(kind, stranger="strangers" in table)
