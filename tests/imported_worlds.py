"""Measurements that other people might have made: tables of responses, turned cases with an encoder, free motion.

The physics is written out here from the facts, in the time domain, and shares no line with the program: a window's
output is a mean over instants, a delayed one is the motion a little earlier, a case that is turned about a shaft sees
gravity turn the other way. Random numbers come from the seed alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.fit.evidence import Evidence
from rig.foreign.manifest import Manifest
from rig.foreign.tables import Foreign, Table
from rig.model import Term
from rig.parts.reading.imported import parts_of

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
G = 9.80665
AXES = "xyz"
FREQUENCIES = np.geomspace(10.0, 250.0, 20)
STATED = ("frequency", "excitation", "magnitude", "u_magnitude", "phase", "u_phase")
WINDOW = 400  # instants of a mean over a window


def manifest(
    kind: str, columns: Sequence[Mapping[str, Any]], files: Sequence[Mapping[str, Any]], **more: Any
) -> Manifest:
    """What the owner of such data would write."""
    return Manifest.model_validate(
        {
            "format": 1, "kind": kind, "unit": {"serial": "made"}, "columns": list(columns), "files": list(files),
            "provenance": {"source": "made for a test", "licence": "none"}, **more,
        }
    )  # fmt: skip


def evidence(*foreign: Foreign) -> Evidence:
    """Everything that a model is compared with."""
    made = [parts_of(one) for one in foreign]
    parts = tuple(part for parts, _ in made for part in parts)
    known: tuple[Term, ...] = tuple(term for _, terms in made for term in terms)
    return Evidence(
        parts, known, tuple(one.run for one in foreign), "made", False,
        tuple(note for part in parts for note in part.notes), tuple(said for part in parts for said in part.blind),
    )  # fmt: skip


# tables of responses


@dataclass(frozen=True)
class Sensor:
    """What an accelerometer does to a sine: gain, a delay in s, and a mean over a window in s."""

    gain: float = 1.0
    delay: float = 0.0
    window: float = 0.0

    def phasor(self, frequency: float) -> complex:
        """Complex ratio of what it shows to what it feels, from instants over one period."""
        t = np.arange(64) / 64.0 / frequency
        back = self.delay + self.window * (np.arange(WINDOW) + 0.5) / WINDOW
        shown = self.gain * np.cos(2.0 * math.pi * frequency * (t[:, None] - back)).mean(axis=1)
        return complex(2.0 * np.mean(shown * np.exp(-2j * math.pi * frequency * t)))


def two_poles(corner: float, damping: float = 0.6, gain: float = 1.0) -> Callable[[float], complex]:
    """A resonator's low-pass (a spring and a mass), by its differential equation's steady state."""

    def phasor(frequency: float) -> complex:
        s = 1j * frequency / corner
        return complex(gain / (1.0 + 2.0 * damping * s + s * s))

    return phasor


def bessel_three(corner: float, gain: float = 1.0) -> Callable[[float], complex]:
    """Three poles of a Bessel filter, from their published places (Thomson 1949), 3 dB down at the corner."""
    poles = np.array([-1.3226758, -1.0474091 + 0.9992644j, -1.0474091 - 0.9992644j])

    def phasor(frequency: float) -> complex:
        return complex(gain * np.prod(-poles / (1j * frequency / corner - poles)))

    return phasor


def response_table(
    sensor: Callable[[float], complex],
    seed: int = 1,
    *,
    repeats: int = 3,
    scatter: float = 1e-3,
    stated: float = 1e-3,
    wrong: float = 1.0,
    frequency: Array = FREQUENCIES,
    level: Array | float | None = None,
) -> Array:
    """Rows of `STATED` (n, 6): every frequency measured some times, with `scatter` of the repeats in magnitude and
    phase (relative, rad), and an error common to the repeats of a frequency of `wrong` times the `stated` uncertainty.
    """  # fmt: skip
    random = np.random.default_rng(seed)
    rows = []
    common = wrong * stated * random.normal(size=(len(frequency), 2))
    levels = np.broadcast_to(10.0 if level is None else level, frequency.shape)
    for _ in range(repeats):
        for k, f in enumerate(frequency.tolist()):
            noise = common[k] + scatter * random.normal(size=2)
            true = sensor(f)
            size = abs(true) * (1.0 + noise[0])
            rows.append([f, levels[k], size, stated * size, float(np.angle(true)) + noise[1], stated])
    return np.array(rows)


def response(tables: Sequence[Array], held: Sequence[int] = (), **changed: Any) -> Foreign:
    """Tables of responses as imported; `held` names those held out by their number."""
    columns = [
        {"column": "frequency", "quantity": "frequency", "unit": "Hz", "role": "reference"},
        {"column": "excitation", "quantity": "excitation", "unit": "m/s²", "role": "reference"},
        {"column": "magnitude", "name": "acc", "quantity": "magnitude", "axis": "z", "tolerance": "5 %",
         "uncertainty_column": "u_magnitude"},
        {"column": "phase", "quantity": "phase", "unit": "rad", "uncertainty_column": "u_phase"},
    ]  # fmt: skip
    files = [{"path": f"table{k}.csv", "held_out": k in held} for k in range(len(tables))]
    made = [Table(f"table {k}", STATED, one, {}, k in held) for k, one in enumerate(tables)]
    return Foreign("made", manifest("response", columns, files, **changed), tuple(made), ())


# cases in motion


@dataclass(frozen=True)
class Wave:
    """A sum of sines: value (k, n) at times (n,), and its derivatives."""

    amplitude: Array  # (k, m)
    omega: Array
    phase: Array
    drift: Array  # (k,) per second

    def at(self, t: Array, order: int = 0) -> Array:
        """A derivative of this order."""
        turn = self.omega[..., None] * t + self.phase[..., None] + 0.5 * math.pi * order
        found = np.sum((self.amplitude * self.omega**order)[..., None] * np.sin(turn), axis=1)
        slope = self.drift[:, None] * (t if order == 0 else np.ones_like(t) if order == 1 else np.zeros_like(t))
        return np.asarray(found + slope)


@dataclass(frozen=True)
class Begun:
    """Motion that begins after a rest of some seconds, within a second and without a jerk: value and first derivative.

    The motion goes through its course at the pace p(t), 0 at rest and 1 later: x(∫p dt).
    """

    whole: Wave
    rest: float

    def at(self, t: Array, order: int = 0) -> Array:
        """Value (order 0) or rate (order 1) at times (n,), (k, n)."""
        if not self.rest:
            return self.whole.at(t, order)
        u = np.clip(t - self.rest, 0.0, 1.0)
        course = u**3 - 0.5 * u**4 + np.maximum(t - self.rest - 1.0, 0.0)  # ∫ of 3u² − 2u³
        return self.whole.at(course, order) * ((3.0 * u**2 - 2.0 * u**3) if order else 1.0)


def wave(
    random: np.random.Generator, speeds: Sequence[float], band: tuple[float, float], drift: Sequence[float]
) -> Wave:
    """Motion with these rms speeds (per second), spread over a band of frequencies, Hz."""
    count = 14
    frequency = random.uniform(*band, size=(len(speeds), count))
    omega = 2.0 * math.pi * frequency
    size = np.asarray(speeds)[:, None] * math.sqrt(2.0 / count) / omega
    return Wave(size, omega, random.uniform(0.0, 2.0 * math.pi, size=omega.shape), np.asarray(drift, np.float64))


@dataclass(frozen=True)
class Unit:
    """A device: gains and zeros of gyros and accelerometers by axis, delays in s, the case turned against the
    reference's frame by a rotation vector (rad, case from reference), and where its accelerometers sit, m.
    """

    rate_gain: Sequence[float] = (1.0, 1.0, 1.0)
    force_gain: Sequence[float] = (1.0, 1.0, 1.0)
    rate_zero: Sequence[float] = (0.01, -0.02, 0.005)
    force_zero: Sequence[float] = (0.1, -0.05, 0.02)
    rate_delay: float = 0.0
    force_delay: float = 0.0
    tilt: Sequence[float] = (0.0, 0.0, 0.0)
    arm: Sequence[float] = (0.0, 0.0, 0.0)
    rate_noise: float = 2e-3  # rad/s
    force_noise: float = 0.02  # m/s²

    def shown(self, t: Array, rate: Callable[[Array], Array], force: Callable[[Array], Array], seed: int) -> Array:
        """Gyros and accelerometers sampled at t (n,), from what the case goes through: (6, n)."""
        random = np.random.default_rng(seed)
        gyros = np.asarray(self.rate_gain)[:, None] * rate(t - self.rate_delay) + np.asarray(self.rate_zero)[:, None]
        felt = np.asarray(self.force_gain)[:, None] * force(t - self.force_delay)
        felt = felt + np.asarray(self.force_zero)[:, None]
        noise = random.normal(size=(6, len(t)))
        return np.concatenate([gyros + self.rate_noise * noise[:3], felt + self.force_noise * noise[3:]])


def clean(seed: int) -> Unit:
    """Gains and zeros within what is usual."""
    random = np.random.default_rng(seed + 77)
    gains, zeros = 1.0 + 0.01 * random.normal(size=(2, 3)), random.normal(size=(2, 3))
    return Unit(rate_gain=gains[0].tolist(), force_gain=gains[1].tolist(),
                rate_zero=(0.02 * zeros[0]).tolist(), force_zero=(0.1 * zeros[1]).tolist())  # fmt: skip


def device_columns(channels: str = "rf", **more: Any) -> list[dict[str, Any]]:
    """Gyros (r) and accelerometers (f) in SI."""
    made: list[dict[str, Any]] = []
    if "r" in channels:
        made += [
            {"column": f"gyro_{a}", "quantity": "rate", "unit": "rad/s", "axis": a, "tolerance": "3 %"} for a in AXES
        ]
    if "f" in channels:
        made += [
            {"column": f"acc_{a}", "quantity": "acceleration", "unit": "m/s²", "axis": a, "tolerance": "3 %"}
            for a in AXES
        ]
    return [{**one, **more} for one in made]


SHOWN = tuple([f"gyro_{a}" for a in AXES] + [f"acc_{a}" for a in AXES])


def bands_of(rate: float | None, force: float | None) -> dict[str, str]:
    """The bands that a manifest states, Hz; what is None is left to the program."""
    return {name: f"{one} Hz" for name, one in (("rate_band", rate), ("force_band", force)) if one is not None}


def about(axis: int, angle: Array) -> Rotation:
    """Rotations about a case axis."""
    vectors = np.zeros((len(angle), 3))
    vectors[:, axis] = angle
    return Rotation.from_rotvec(vectors)


def rotation(
    unit: Unit,
    seed: int = 1,
    *,
    seconds: float = 60.0,
    axis: str = "z",
    upright: bool = True,
    lies: float = 0.7,
    sense: int = 1,
    stated: int | None = None,
    jitter: float = 1e-3,
    steps: float = math.radians(360.0 / 4096),
    rows: float = 100.0,
    band: float | None = 5.0,
    channels: str = "rf",
    doubled: float = 0.003,
    rest: float = 0.0,
    sheet: Mapping[str, Any] | None = None,
    disk: Callable[[Array], Array] | None = None,
) -> Foreign:
    """A log of an encoder with a device that turns: rows at uneven instants, stamps that are off by `jitter`, an angle
    in `steps` that wraps, and now and then a row twice. `lies` rad: how gravity lies at angle zero of a level axis.
    `sense` −1: the encoder counts against the right-hand turn. `rest` s stands still before; `sheet` is the noise of
    every channel of the device as its manifest states it. `disk`: what an encoder that is not true shows at an angle.
    A `band` of None is not stated.
    """  # fmt: skip
    random = np.random.default_rng(seed)
    swung = Begun(wave(random, [1.6], (0.05, 2.5), [0.4]), rest)
    interval = 1.0 / rows
    t = np.cumsum(interval * (1.0 + 0.1 * random.uniform(-1.0, 1.0, size=round(seconds * rows))))
    k = AXES.index(axis)
    case = Rotation.from_rotvec(np.asarray(unit.tilt))

    def rate(at: Array) -> Array:
        shaft = np.zeros((3, len(at)))
        shaft[k] = swung.at(at, 1)[0]
        return np.asarray(case.apply(shaft.T).T)

    def force(at: Array) -> Array:
        up = np.zeros(3)
        if upright:
            up[k] = 1.0
        else:
            up[(k + 1) % 3], up[(k + 2) % 3] = math.cos(lies), math.sin(lies)
        seen = about(k, swung.at(at)[0]).inv().apply(np.tile(up, (len(at), 1)))
        return np.asarray(G * case.apply(seen).T)

    values = unit.shown(t, rate, force, seed + 1000)
    angle = sense * swung.at(t)[0]
    angle = angle if disk is None else disk(angle)
    read = np.mod(np.round(angle / steps) * steps if steps else angle, 2.0 * math.pi)
    stamps = t + jitter * random.normal(size=len(t))
    table = np.column_stack([stamps, read, *values])
    twice = np.sort(np.concatenate([np.arange(len(t)), random.choice(len(t), round(doubled * len(t)))]))
    more = {} if sheet is None else {"noise": dict(sheet)}
    columns = [{"column": "angle", "quantity": "angle", "unit": "rad", "role": "reference"},
               *device_columns(channels, **more)]  # fmt: skip
    turned: dict[str, Any] = {"axis": axis, "upright": upright}
    if stated is not None:
        turned["sense"] = stated
    made = manifest(
        "rotation", columns, [{"path": "log.csv"}], time={"column": "t", "unit": "s"}, rotation=turned,
        compared=bands_of(band, band),
    )  # fmt: skip
    return Foreign("made", made, (Table("log", ("t", "angle", *SHOWN), table[twice], {}, False),), ())


def changed(foreign: Foreign, column: str, law: Callable[[Array], Array]) -> Foreign:
    """The same log with another channel in the place of one, whose rows the law turns into its own, (n,)."""
    (table,) = foreign.tables
    values, at = table.values.copy(), table.names.index(column)
    values[:, at] = law(values[:, at])
    return replace(foreign, tables=(replace(table, values=values),))


@dataclass(frozen=True)
class Tumbling:
    """A body thrown about: Euler angles and position as sums of sines, all else follows."""

    angles: Wave
    place: Wave

    @classmethod
    def of(cls, seed: int, speed: float = 1.5, sway: float = 0.5) -> Tumbling:
        random = np.random.default_rng(seed)
        angles = wave(random, [speed, 0.7 * speed, speed], (0.1, 2.5), [0.5, 0.0, -0.3])
        return cls(angles, wave(random, [sway] * 3, (0.2, 2.5), [0.0] * 3))

    def attitude(self, t: Array) -> Rotation:
        """World from body."""
        return Rotation.from_euler("ZYX", self.angles.at(t)[::-1].T)

    def rate(self, t: Array) -> Array:
        """Angular rate in the body, from attitudes a moment before and after, rad/s, (3, n)."""
        h = 1e-4
        return np.asarray((self.attitude(t - h).inv() * self.attitude(t + h)).as_rotvec().T / (2.0 * h))

    def force(self, t: Array, arm: Array) -> Array:
        """Specific force of a point at `arm` (m, body) in the body, m/s², (3, n): its path differentiated twice."""
        h = 2e-4
        path = [self.place.at(one).T + self.attitude(one).apply(arm) for one in (t - h, t, t + h)]
        acceleration = (path[0] - 2.0 * path[1] + path[2]) / h**2
        return np.asarray(self.attitude(t).inv().apply(acceleration + G * np.eye(3)[2]).T)


def motion(
    unit: Unit,
    seed: int = 1,
    *,
    seconds: float = 40.0,
    rows: float = 285.7,
    gaps: int = 2,
    place_noise: float = 2e-4,
    turn_noise: float = 1e-3,
    bands: tuple[float | None, float | None] = (6.0, 6.0),
    speed: float = 1.5,
    channels: str = "rf",
) -> Foreign:
    """A device thrown about before cameras: quaternions and positions with noise and some gaps of 0.3 s."""
    random = np.random.default_rng(seed + 500)
    body = Tumbling.of(seed, speed)
    t = np.arange(round(seconds * rows)) / rows
    case = Rotation.from_rotvec(np.asarray(unit.tilt))
    arm = case.inv().apply(np.asarray(unit.arm))  # the device's arm is along its own axes
    values = unit.shown(
        t, lambda at: case.apply(body.rate(at).T).T, lambda at: case.apply(body.force(at, arm).T).T, seed + 1000
    )
    shaken = Rotation.from_rotvec(turn_noise * random.normal(size=(len(t), 3)))
    turns = (body.attitude(t) * shaken).as_quat()
    where = body.place.at(t).T + place_noise * random.normal(size=(len(t), 3))
    for begin in random.integers(len(t) // 10, len(t) - len(t) // 10, size=gaps):
        turns[begin : begin + round(0.3 * rows)] = np.nan
        where[begin : begin + round(0.3 * rows)] = np.nan
    columns = [
        *device_columns(channels),
        *({"column": f"q{c}", "quantity": "quaternion", "component": c, "role": "reference"} for c in "wxyz"),
        *({"column": f"p{a}", "quantity": "position", "unit": "m", "axis": a, "role": "reference"} for a in AXES),
    ]
    made = manifest(
        "motion", columns, [{"path": "track.csv"}], time={"column": "t", "unit": "s"}, pose={},
        compared=bands_of(*bands),
    )  # fmt: skip
    names = ("t", *SHOWN, "qw", "qx", "qy", "qz", "px", "py", "pz")
    table = np.column_stack([t, *values, turns[:, 3], turns[:, 0], turns[:, 1], turns[:, 2], where])
    return Foreign("made", made, (Table("track", names, table, {}, False),), ())


def with_lines(foreign: Foreign, lines: int) -> Foreign:
    """The same rotation with an encoder's outputs A, B and index, 0 or 5 V, in place of its angle; A leads forwards."""
    (table,) = foreign.tables
    turns = table.of("angle") / (2.0 * math.pi)
    phase = np.mod(turns * lines, 1.0)
    a, b = (5.0 * (np.mod(phase - shift, 1.0) < 0.5) for shift in (0.0, 0.25))
    index = 5.0 * (np.mod(turns, 1.0) < 0.5 / lines)
    columns = [
        {"column": name, "quantity": name, "unit": "V", "role": "reference"}
        for name in ("line_a", "line_b", "index_line")
    ]
    made = manifest(
        "rotation", [*columns, *device_columns("r")], [{"path": "log.csv"}], time={"column": "t", "unit": "s"},
        rotation={"axis": "z", "upright": True, "lines": lines}, compared={"rate_band": "5 Hz", "force_band": "5 Hz"},
    )  # fmt: skip
    rest = [table.of(name) for name in SHOWN]
    values = np.column_stack([table.of("t"), a, b, index, *rest])
    names = ("t", "line_a", "line_b", "index_line", *SHOWN)
    return Foreign("made", made, (Table("log", names, values, {}, False),), ())
