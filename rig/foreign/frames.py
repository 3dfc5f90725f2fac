"""A triad's axes against its reference's: of the 48 ways to read three channels, does another than the stated one fit?

A triad that is mounted or written down otherwise than its manifest says shows  s = g·Q·t + b,  with t what the
reference says along the stated axes, Q a signed permutation, g > 0 a factor and b its zeros. What Q leaves is
|s|² − 2g·tr(QᵀC) + g²|t|²  with  C = Σ s·tᵀ,  so that all 48 cost hardly more than one. Nothing physical does this: as
an effect it would be cross-axis sensitivity of 100 %. A frame that is some degrees off is nearest to the stated reading
and remains what it is; between 26° and 64° no reading fits, and nothing is said.

What the reference leaves open (the sense of an encoder, the way gravity lies at its angle zero, a time between both
logs) every reading may choose as suits it best, the stated one too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rig.foreign.faults import without_faults
from rig.foreign.finding import Finding
from rig.foreign.manifest import SI_OF, Column, Manifest, Quantity, Segment
from rig.foreign.pairs import AXES, body_rate, quaternions, running
from rig.foreign.tables import Array, Foreign, Table

STRETCH = 0.05  # s, over which both sides are averaged, and a step of the time between both logs
LATEST = 0.5  # s by which the logs of both sides may be apart
FEWEST = 60  # stretches
FEWEST_POSES = 3
FITS = 0.4  # of what the stated reading leaves, and of what is shown: 2 sin(13°) ÷ 2 sin(32°), so 26° beside another
ALIKE = 1.2  # readings that leave so much more than the best are not told from it
ROUNDING = 1e-6  # of what is shown
FACTORS = (0.5, 2.0)  # of accelerometers against gravity; more is a unit, or the pull of a case beside its axis
ANY_FACTOR = (0.0, math.inf)
PULLED = 0.3  # of gravity, by a known radius: from there on the case's place decides what is felt
PHASES = 72  # ways in which gravity may lie at angle zero: 2.5° beside one of them is 4 % of it
BACK = "the encoder counting the other way (`rotation: {{sense: {:g}}}`)"
SIGNS = ("−", "+")


def _readings() -> Array:
    """All signed permutations, the stated one first, (48, 3, 3): what channel k shows is along axis j."""
    found = [
        np.diag(signs)[:, list(order)]
        for order in itertools.permutations(range(3)) for signs in itertools.product((1.0, -1.0), repeat=3)
    ]  # fmt: skip
    return np.array(found)


READINGS = _readings()
Triad = tuple[Column, Column, Column]
Vectors = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """What a triad has `shown` (n, 3), and what its reference says along the stated axes: one of the sums of `basis`
    (b, n, 3) with `weights` (m, b); all SI, one row a stretch or a pose, NaN where nothing is known.

    `loose` zeros may have any size; others are small beside what is shown. `factors` that a sensitivity may be off by;
    `latest` rows between both. `instead`: what else in the manifest may be wrong, and the basis that it would give.
    """

    triad: Triad
    shown: Vectors
    basis: Vectors
    weights: Array = field(default_factory=lambda: np.ones((1, 1)))
    loose: bool = False
    factors: tuple[float, float] = FACTORS
    latest: int = 0
    instead: Mapping[str, Vectors] = field(default_factory=dict)

    def errors(self) -> Array:
        """What every reading leaves at best, rms of a channel, SI, (48,); infinite where nothing moves."""
        found = np.full(len(READINGS), math.inf)
        for late in range(-self.latest, self.latest + 1):
            found = np.minimum(found, self._errors(late))
        return np.asarray(np.sqrt(np.maximum(found, 0.0) / 3.0))

    def _errors(self, late: int) -> Array:
        """Squares that are left with the triad `late` rows behind its reference, (48,)."""
        count = len(self.shown) - abs(late)
        shown, basis = self.shown[max(late, 0) :][:count], self.basis[:, max(-late, 0) :][:, :count]
        known = np.isfinite(shown).all(axis=1) & np.isfinite(basis).all(axis=(0, 2))
        shown, basis = shown[known], basis[:, known]
        if len(shown) < (FEWEST if self.latest else FEWEST_POSES):
            return np.full(len(READINGS), math.inf)
        if self.loose:
            shown, basis = shown - shown.mean(axis=0), basis - basis.mean(axis=1, keepdims=True)
        cross = np.einsum("nk,bnj->bkj", shown, basis) / len(shown)
        power = np.einsum("bnj,cnj->bc", basis, basis) / len(shown)
        towards = np.einsum("mb,bkj,qkj->mq", self.weights, cross, READINGS)
        size = np.einsum("mb,bc,mc->m", self.weights, power, self.weights)[:, None]
        if not size.max() > 0.0:
            return np.full(len(READINGS), math.inf)
        factor = np.clip(towards / np.maximum(size, np.finfo(float).tiny), *self.factors)
        left = float(np.mean(np.sum(shown**2, axis=1))) - 2.0 * factor * towards + factor**2 * size
        return np.asarray(left.min(axis=0))

    @property
    def size(self) -> float:
        """Of what is shown, rms of a channel, SI."""
        shown = self.shown[np.isfinite(self.shown).all(axis=1)]
        return float(np.sqrt(np.mean((shown - (shown.mean(axis=0) if self.loose else 0.0)) ** 2)))


@dataclass(frozen=True)
class Other:
    """The reading that fits where the stated one does not: `way` (3, 3); `told` (3,) says of which channels that is
    sure, `handed` whether it is how the triad is handed.

    What it and the stated one leave, rms of a channel, SI.
    """

    way: Array
    told: NDArray[np.bool_]
    handed: bool
    left: float
    stated: float


def findings(data: Foreign, table: Table) -> Iterator[Finding]:
    """Triads of one file that another reading than the stated one fits."""
    for seen in seen_in(data, table):
        other = other_reading(seen)
        if other is not None:
            wrong = [one for one, way, own in zip(seen.triad, other.way, np.eye(3), strict=True) if np.any(way != own)]
            accepted = all(one.findings == "accepted" for one in wrong)
            yield Finding("frame", table.label, _text(seen, other), wrong[0].channel, accepted=accepted)


def other_reading(seen: Seen) -> Other | None:
    """The reading that is believed in place of the stated one, if there is one: of all that fit as well as the best the
    one that moves fewest channels.
    """
    errors = seen.errors()
    best = float(errors.min())
    if not (math.isfinite(best) and best < FITS * min(float(errors[0]), seen.size)):  # no size without rows
        return None
    near = np.flatnonzero(errors <= ALIKE * best + ROUNDING * seen.size)
    chosen = min(near, key=lambda one: (moved(READINGS[one]), errors[one]))
    told = np.all(READINGS[near] == READINGS[chosen], axis=(0, 2))
    handed = np.ptp(np.linalg.det(READINGS[near])) < 1.0
    return Other(READINGS[chosen], told, bool(handed), float(errors[chosen]), float(errors[0]))


def moved(way: Array) -> int:
    """Channels that it reads otherwise than stated."""
    return int(np.count_nonzero(np.any(way != np.eye(3), axis=1)))


# words


def in_words(triad: Sequence[Column], way: Array, handed: bool = True) -> str:
    """What each channel that is read otherwise shows: `gyro_x shows −y, gyro_y shows +x (a left-handed triad)`."""
    said = []
    for one, row, own in zip(triad, way, np.eye(3), strict=True):
        if np.any(row != own):
            axis = int(np.flatnonzero(row)[0])
            said.append(f"{one.channel} shows {SIGNS[int(row[axis] > 0.0)]}{AXES[axis]}")
    return ", ".join(said) + (" (a left-handed triad)" if handed and np.linalg.det(way) < 0.0 else "")


def mended(triad: Sequence[Column], way: Array) -> str:
    """What the manifest has to say instead, column by column."""
    said = []
    for one, row, own in zip(triad, way, np.eye(3), strict=True):
        axis = int(np.flatnonzero(row)[0])
        keys = [f"axis: {AXES[axis]}"] if not own[axis] else []
        keys += [f"sensitivity: {_turned_about(one)}"] if row[axis] < 0.0 else []
        if keys:
            said.append(f"{one.channel} `{', '.join(keys)}`")
    return "; ".join(said)


def _turned_about(one: Column) -> str:
    """Its sensitivity with the other sign."""
    if one.sensitivity is None:
        return f"-1 {one.unit} per {one.unit}"
    stated = one.sensitivity.strip()
    return stated[1:] if stated.startswith("-") else f"-{stated.removeprefix('+')}"


def _text(seen: Seen, other: Other) -> str:
    unit, better = SI_OF[seen.triad[0].quantity], other.stated / max(other.left, ROUNDING * seen.size)
    text = (
        f"axes are not those of the reference: {in_words(seen.triad, other.way, other.handed)}; so read "
        f"{other.left:.3g} {unit} is left (rms), as stated {other.stated:.3g} {unit}, {better:.3g} times as much"
    )
    if not other.told.all():
        channels = ", ".join(one.channel for one, sure in zip(seen.triad, other.told, strict=True) if not sure)
        text += f" (which axis, or which sign, this record does not tell of {channels})"
    for words, basis in seen.instead.items():
        if replace(seen, basis=basis).errors()[0] < ALIKE * other.left:
            text += f"; {words} would do as well"
    return f"{text}; in the manifest: {mended(seen.triad, other.way)}"


# what was shown, and what the reference says


def triads(made: Manifest, quantity: Quantity) -> list[Triad]:
    """The device's channels of a quantity along x, y and z; of several along each axis the first of each, and so on."""
    each = [[one for one in made.of("device", quantity) if one.axis == axis] for axis in AXES]
    return list(zip(*each, strict=True)) if len({len(one) for one in each}) == 1 else []


def seen_in(data: Foreign, table: Table) -> Iterator[Seen]:
    """Every triad of a file of which the reference says something."""
    match data.manifest.kind:
        case "rotation":
            yield from _of_rotation(data, table)
        case "motion":
            yield from _of_motion(data, table)
        case "poses":
            yield from _of_poses(data, table)


@dataclass(frozen=True)
class _Stretches:
    """Rows of a file cut into stretches: `rows` whose time runs, `edges` among them, and the time there, s."""

    rows: NDArray[np.intp]
    edges: NDArray[np.intp]
    at: Array

    @classmethod
    def of(cls, rows: NDArray[np.intp], time: Array) -> _Stretches | None:
        """None for a file that is too short."""
        if len(rows) < 4 * FEWEST:
            return None
        size = max(4, round(STRETCH / float(np.median(np.diff(time)))))
        edges = np.arange(0, len(rows), size)
        return cls(rows, edges, time[edges]) if len(edges) > FEWEST else None

    @property
    def seconds(self) -> Array:
        """How long each lasts, (n,); NaN for one with a gap."""
        lasting = np.diff(self.at)
        return np.where(lasting < 2.0 * np.median(lasting), lasting, math.nan)

    @property
    def latest(self) -> int:
        """Stretches by which both logs may be apart."""
        return round(LATEST / float(np.nanmedian(self.seconds)))

    def means(self, values: Array) -> Array:
        """Of values (rows of the file, ...) in every stretch, (n, ...); NaN where one is none."""
        size, count = int(self.edges[1]), len(self.edges) - 1
        return np.asarray(values[self.rows[: count * size]].reshape(count, size, *values.shape[1:]).mean(axis=1))

    def shown(self, data: Foreign, table: Table, triad: Triad) -> Array:
        """Means of a triad, SI, (n, 3)."""
        return self.means(np.column_stack([without_faults(data, table, one) for one in triad]))


def _of_rotation(data: Foreign, table: Table) -> Iterator[Seen]:
    """Rates about the axis, and gravity along it, or going round across it."""
    rotation, angles = data.manifest.rotation, data.manifest.of("reference", "angle")
    if rotation is None or not angles:
        return
    angle, (rows, time) = without_faults(data, table, angles[0]), running(data, table)
    good = np.isfinite(angle[rows])
    cut = _Stretches.of(rows[good], time[good])
    if cut is None:
        return
    angle[cut.rows] = np.unwrap(angle[cut.rows])
    rate = np.diff(angle[cut.rows[cut.edges]]) / cut.seconds
    axis, senses = AXES.index(rotation.axis), {1.0, -1.0} if rotation.sense is None else {float(rotation.sense)}
    about = rate[:, None] * np.eye(3)[axis]
    for triad in triads(data.manifest, "rate"):
        shown = cut.shown(data, table, triad)
        ways = np.array([[one] for one in sorted(senses)])
        back = {} if len(senses) > 1 else {BACK.format(-min(senses)): -about[None]}
        seen = Seen(triad, shown, about[None], ways, True, ANY_FACTOR, cut.latest, back)
        yield seen
        if len(senses) > 1 and other_reading(seen) is None:  # whoever reads them takes the encoder's sense from here
            senses = {min(senses, key=lambda one: float(replace(seen, weights=np.array([[one]])).errors()[0]))}
    calm = np.where(rate**2 * rotation.radius < PULLED * data.manifest.gravity.value, 1.0, math.nan)
    basis, weights = _plumb(data, cut, len(angle)) if rotation.upright else _level(cut, angle, axis, senses)
    basis = data.manifest.gravity.value * calm[:, None] * basis
    back = {BACK.format(-min(senses)): basis[[2, 3, 0, 1]]} if len(basis) == 4 and len(senses) == 1 else {}
    for triad in triads(data.manifest, "acceleration"):
        yield Seen(triad, cut.shown(data, table, triad), basis, weights, latest=cut.latest, instead=back)


def _plumb(data: Foreign, cut: _Stretches, rows: int) -> tuple[Vectors, Array]:
    """Up in the case of an upright axis, (1, n, 3), as it is stated where it is, and else either way."""
    assert data.manifest.rotation is not None
    axis, up = AXES.index(data.manifest.rotation.axis), np.full(rows, math.nan)
    for one in data.manifest.segments:
        if one.up is not None:
            up[one.first : one.last] = _up(one)[axis]
    stated = cut.means(up)
    if not np.isfinite(stated).any():
        return np.ones((1, len(stated), 1)) * np.eye(3)[axis], np.array([[1.0], [-1.0]])
    return (stated[:, None] * np.eye(3)[axis])[None], np.ones((1, 1))


def _level(cut: _Stretches, angle: Array, axis: int, senses: set[float]) -> tuple[Vectors, Array]:
    """Up in a case that turns about a level axis, e^{j(φ − σθ)} across it for some φ, (4, n, 3), and what φ and the
    sense σ make of that (m, 4).
    """
    first, second = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    cosine, sine = cut.means(np.cos(angle))[:, None], cut.means(np.sin(angle))[:, None]
    basis = [b for s in (1.0, -1.0) for b in (cosine * first - s * sine * second, s * sine * first + cosine * second)]
    phases = 2.0 * math.pi * np.arange(PHASES) / PHASES
    lies, none = np.stack([np.cos(phases), np.sin(phases)], axis=1), np.zeros((PHASES, 2))
    ways = [np.hstack([lies, none] if sense > 0.0 else [none, lies]) for sense in senses]
    return np.array(basis), np.concatenate(ways)


def _of_motion(data: Foreign, table: Table) -> Iterator[Seen]:
    """Rates and forces in the body as its track of poses has them."""
    attitude, (rows, time) = quaternions(data, table), running(data, table)
    cut = _Stretches.of(rows, time)
    pose, places = data.manifest.pose, {one.axis: one for one in data.manifest.of("reference", "position")}
    if attitude is None or cut is None or pose is None:
        return
    track = attitude[cut.rows] * ((1.0, -1.0, -1.0, -1.0) if pose.quaternion == "world_to_body" else 1.0)
    rate = body_rate(track[cut.edges], cut.at) * np.isfinite(cut.seconds / cut.seconds)[:, None]
    for triad in triads(data.manifest, "rate"):
        shown = cut.shown(data, table, triad)
        yield Seen(triad, shown, rate[None], loose=True, factors=ANY_FACTOR, latest=cut.latest)
    if set(places) != set(AXES):
        return
    place = cut.means(np.column_stack([without_faults(data, table, places[axis]) for axis in AXES]))
    path = np.full_like(place, math.nan)
    path[1:-1] = np.diff(place, 2, axis=0) / (cut.seconds[1:-1, None] ** 2)
    middle = track[(cut.edges[:-1] + cut.edges[1:]) // 2]
    force = {up: _in_body(middle, path + data.manifest.gravity.value * np.eye(3)[AXES.index(up)]) for up in AXES}
    others = {f"`pose: {{up: {up}}}`": one[None] for up, one in force.items() if up != pose.up}
    for triad in triads(data.manifest, "acceleration"):
        shown = cut.shown(data, table, triad)
        yield Seen(triad, shown, force[pose.up][None], latest=cut.latest, instead=others)


def _in_body(attitude: Array, vectors: Array) -> Array:
    """Vectors of the world (n, 3) in a body at attitudes (n, 4), body to world."""
    w, v = attitude[:, :1], -attitude[:, 1:]
    return np.asarray(vectors + 2.0 * np.cross(v, np.cross(v, vectors) + w * vectors))


def _up(one: Segment) -> Array:
    """What is up in the case, (3,)."""
    assert one.up is not None
    return np.asarray((-1.0 if one.up[0] == "-" else 1.0) * np.eye(3)[AXES.index(one.up[1])])


def _of_poses(data: Foreign, table: Table) -> Iterator[Seen]:
    """Forces in poses that say what is up, and mean rates of turns by known angles, two of them at least."""
    stated = [one for one in data.manifest.segments if one.up is not None and one.turn is None]
    for triad in triads(data.manifest, "acceleration") if len({one.up for one in stated}) >= FEWEST_POSES else ():
        up = data.manifest.gravity.value * np.array([_up(one) for one in stated])
        yield Seen(triad, np.array([_mean(data, table, triad, one) for one in stated]), up[None])
    turns = [one for one in data.manifest.segments if one.turn is not None and one.angle is not None]
    for triad in triads(data.manifest, "rate") if len({one.turn for one in turns}) > 1 else ():
        still = [_mean(data, table, triad, one) for one in data.manifest.segments if one.turn is None]
        zero = np.nanmean(still, axis=0) if still else np.zeros(3)
        time = data.time(table)
        seconds = np.array([time[one.last - 1] - time[one.first] for one in turns])
        shown = np.array([_mean(data, table, triad, one) - zero for one in turns])
        angles = np.array([(one.angle or 0.0) * np.eye(3)[AXES.index(one.turn or "x")] for one in turns])
        yield Seen(triad, shown, (angles / seconds[:, None])[None], factors=ANY_FACTOR)


def _mean(data: Foreign, table: Table, triad: Triad, one: Segment) -> Array:
    """Of a triad in a segment, SI, (3,)."""
    values = np.array([without_faults(data, table, column)[one.first : one.last] for column in triad])
    return np.asarray(np.nanmean(values, axis=1)) if np.isfinite(values).any(axis=1).all() else np.full(3, math.nan)
