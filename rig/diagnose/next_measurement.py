"""What to measure next: for every measurement that the bench can do, how well it would decide between what is open.

A measurement that has not been made is a part whose motion is known and whose rows are those that one of two rival
models predicts. The other model is readjusted to the old rows and the new ones together (linearised about its fit);
the χ² that it cannot get rid of is the expected power to decide (T-optimal design: Atkinson and Fedorov 1975). The most
powerful comes first, among equals the quickest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rig.diagnose.diagnose import Choice, Diagnosis
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.fit.floor import Floor, carrying, said
from rig.motion import ORDERS, Array
from rig.parts.part import Indices, Part
from rig.parts.sines import LINES, SineRecords, Sines, directions
from rig.parts.turning import Turning

DECIDES = 16.0  # expected χ² between two models that settles it
HELPS = 4.0  # and that a few repetitions bring there
LIKELY = 0.02  # probability of a rival that is still open
MOST_RIVALS = 4
HIGHEST = 1000.0  # Hz; the converter allows 1220, but records of 1 s lose whole cycles near that
RECORD, PAUSE = 1.0, 1.6  # s of one point, and between two; longer ones lose whole cycles
ASIDE = 0.002  # of the acceleration: harmonics that a shaker has
MINUTES_MOUNT = 4.0  # of an operator: mount, cables, beam


@dataclass(frozen=True)
class Option:
    """One measurement: what it is, why it would help, how long it takes, the procedure, and how its part looks."""

    name: str
    why: str
    minutes: float
    document: Mapping[str, Any]
    part: Callable[[], Part]


@dataclass(frozen=True)
class Ranked:
    """A measurement with its expected power (χ² between the two rivals it tells least apart), and which they are."""

    option: Option
    power: float
    pair: tuple[str, str]

    @property
    def decides(self) -> bool:
        """Whether it is expected to settle the question."""
        return self.power >= DECIDES

    @property
    def helps(self) -> bool:
        """Whether it is worth its time although one of it may not settle the question."""
        return self.power >= HELPS


def rivals(diagnosis: Diagnosis) -> list[Choice]:
    """Choices of the last step that the data leave open, best first; fewer than two: nothing is open."""
    if not diagnosis.steps:
        return []
    step = diagnosis.steps[-1]
    open_ones = {one.term.key: one for one in (*step.members, *step.others)}
    likely = [o for o in open_ones.values() if o.probability > LIKELY or o in step.members]
    return sorted((one for one in likely if one.fit is not None), key=lambda one: -one.merit)[:MOST_RIVALS]


def ranked(diagnosis: Diagnosis, floor: Floor | None = None) -> list[Ranked]:
    """All measurements of this bench, the most powerful first, of those that decide well the quickest.

    A new mounting brings ripple of its own: the floor's. [] if nothing is open.
    """
    open_ones = rivals(diagnosis)
    if len(open_ones) < 2:
        return []
    found = []
    for option in options(diagnosis.base.parts):
        part = option.part()
        if floor is not None and floor.size > 0.0 and isinstance(part, Sines):
            part = carrying(part, floor)
        powers = [(power(one, other, part), (one.name, other.name)) for one, other in _pairs(open_ones)]
        least, pair = min(powers)
        found.append(Ranked(option, least, pair))
    return sorted(found, key=lambda one: (-min(one.power, 4.0 * DECIDES), one.option.minutes, -one.power))


def _pairs(open_ones: Sequence[Choice]) -> Iterator[tuple[Choice, Choice]]:
    """The best against each of the others, both ways round: the truth may be either."""
    for other in open_ones[1:]:
        yield open_ones[0], other
        yield other, open_ones[0]


def power(truth: Choice, rival: Choice, part: Part) -> float:
    """χ² that the rival would be left with if the first were true and this part were measured."""
    assert truth.fit is not None
    assert rival.fit is not None
    expected = part.whitened(part.raw(_local(truth.fit, part), truth.fit.state.terms))
    normal, columns, predicted = _extended(rival.fit, part)
    left = expected - predicted
    gradient = columns.T @ left
    whole = normal + columns.T @ columns
    return max(float(left @ left) - float(gradient @ fitting.inverse(whole) @ gradient), 0.0)


def _local(found: Fit, part: Part) -> Any:
    """A model's channels in a part that has not been measured; zeros of a part of the same place."""
    for number, other in enumerate(found.parts):
        if other.place == part.place and other.channels.names == part.channels.names:
            return found.state.local(part, number)
    raise ValueError(f"found no part like {part.name}")


def _extended(found: Fit, part: Part) -> tuple[Array, Array, Array]:
    """The rival's normal matrix, columns and prediction with the new part's own zeros free."""
    number = next(n for n, p in enumerate(found.parts) if p.place == part.place)
    state = replace(
        found.state,
        zero=(*found.state.zero, found.state.zero[number]),
        nuisance=(*found.state.nuisance, np.zeros(part.extra.shape[1])),
    )
    parts = (*found.parts, part)
    order = fitting.layout(parts, state)
    raw = part.raw(state.local(part, len(parts) - 1), state.terms)
    columns = np.zeros((part.rows, order.size))
    for block in fitting.blocks_of(part, len(parts) - 1, state, order, raw):
        columns[block.rows, block.columns] += block.matrix
    old = fitting.layout(found.parts, found.state)
    normal = np.zeros((order.size, order.size))
    places = _places(old, order)
    normal[np.ix_(places, places)] = found.normal
    own = order.nuisances[-1] + np.arange(part.extra.shape[1])
    normal[own, own] += 1.0  # their prior
    return normal, columns, part.whitened(raw)


def _places(old: fitting.Layout, new: fitting.Layout) -> Indices:
    """Where the parameters of a smaller layout stand in a larger one."""
    starts = [0, *old.zeros, *old.nuisances, *old.terms, old.size]
    targets = [0, *new.zeros[:-1], *new.nuisances[:-1], *new.terms, new.size]
    place = np.zeros(old.size, np.intp)
    for start, end, target in zip(starts, starts[1:], targets, strict=False):
        place[start:end] = target + np.arange(end - start)
    return place


def options(parts: Sequence[Part]) -> list[Option]:
    """The measurements that this bench can do, as far as a part of the same kind shows how they would look."""
    found: list[Option] = []
    sines = [part for part in parts if isinstance(part, Sines)]
    turnings = [part for part in parts if isinstance(part, Turning)]
    if sines:
        found += _on_shaker(sines[0])
    if turnings:
        found += _on_turntable(turnings[0])
    return found


def _on_shaker(template: Sines) -> Iterator[Option]:
    axis = template.data.axis
    band, wide = (20.0, 500.0), (60.0, HIGHEST)
    others, both = [one for one in "xyz" if one != axis], ("full", "quarter")
    for name, why, of, levels, limits, points in (
        ("repeat", "more of the same", axis, both, band, 24),
        ("wider band", "dynamics that look alike below 500 Hz part above it", axis, both, wide, 24),
        ("wider band, more points", "the same with less noise", axis, both, wide, 64),
        ("three levels", "laws of level part", axis, ("full", "half", "eighth"), band, 24),
        ("more points", "less noise in every parameter", axis, both, band, 64),
        (f"axis {others[0]}", "what goes with the cube turns with it", others[0], both, band, 24),
        (f"axis {others[1]}", "what goes with the cube turns with it", others[1], both, band, 24),
    ):
        minutes = MINUTES_MOUNT + points * len(levels) * (RECORD + PAUSE) / 60.0
        document = {
            "procedure": "frequency_sweep", "axis": of, "start": f"{limits[0]:g} Hz", "stop": f"{limits[1]:g} Hz",
            "points": points, "levels": list(levels),
        }  # fmt: skip
        yield Option(name, why, minutes, document, _sweep(template, of, levels, limits, points))
    later = {"title": "The same sweep ten minutes later",
             "steps": [{"wait": "600 s"}, {"procedure": "frequency_sweep", "axis": axis}]}  # fmt: skip
    yield Option("later", "temperature, supply and time since power-up part", 16.0, later,
                 _sweep(template, axis, both, band, 24, later=600.0))  # fmt: skip


def unmeasured(evidence: Evidence) -> list[tuple[str, str]]:
    """What these runs cannot show though this bench can: a sentence, and the command that measures it."""
    found: list[tuple[str, str]] = []
    axes = sorted({part.data.axis for part in evidence.sines})
    levels = {level for part in evidence.sines for level in part.data.level if level != "rest"}
    if not evidence.turnings:
        found.append(("no turntable run: nothing that only a rate shows", "rig turntable --all"))
    if not axes:
        found.append(("no sweep: dynamics of the accelerometers, nonlinearity, cross-axis", "rig sweep --axis x"))
    if len(levels) == 1:
        command = f"rig sweep --axis {axes[0]} --levels full,quarter"
        found.append(("one drive level: level and frequency cannot be told apart", command))
    if evidence.sines and said(None) in evidence.blind:
        found.append(("the bench's own ripple is not known", "rig run remounts.yaml && rig floor last"))
    for axis in "xyz" if axes else "":
        if axis not in axes:
            found.append((f"not driven along {axis}", f"rig sweep --axis {axis}"))
    return found


SHARES = {"full": 1.0, "half": 0.5, "quarter": 0.25, "eighth": 0.125}


def _sweep(
    template: Sines, axis: str, levels: Sequence[str], limits: tuple[float, float], points: int, later: float = 0.0
) -> Callable[[], Part]:  # fmt: skip
    return lambda: Sines(swept(template.data, axis, levels, limits, points, later=later))


def swept(
    data: SineRecords, axis: str, levels: Sequence[str], limits: tuple[float, float], points: int,
    seconds: float = RECORD, later: float = 0.0,
) -> SineRecords:  # fmt: skip
    """A sweep as it would be recorded after the one of `data`: motion, noise and conditions, nothing observed."""
    peaks = np.abs(data.shown[:, 1])
    highest = float(peaks.max())
    stroke = float(np.max(peaks / np.maximum((2.0 * math.pi * data.frequency) ** 2, 1.0)))
    f = np.tile(np.geomspace(*limits, points), len(levels))
    share = np.repeat([SHARES[level] for level in levels], points)
    target = share * np.minimum(highest, stroke * (2.0 * math.pi * f) ** 2)
    order = np.argsort(np.modf(np.arange(len(f)) * 0.6180339887)[0])  # a fixed disorder
    f, target = f[order], target[order]
    along = np.zeros((len(f), ORDERS), np.complex128)
    along[:, 1] = target
    along[:, 2:] = ASIDE * target[:, None]
    begin = np.asarray(float(data.end.max()) + 60.0 + later + np.arange(len(f)) * (seconds + PAUSE), np.float64)
    channels = data.channels
    lines = np.zeros((len(channels.names), len(f), LINES))
    at = np.concatenate([f[:, None] * np.arange(ORDERS), np.full((len(f), LINES - ORDERS), data.mains)], axis=1)
    for c, model in enumerate(data.noise):
        lines[c] = model.density(np.minimum(np.maximum(at, 1.0), 0.49 * model.rate)) / seconds
    lines[:, at > 0.49 * data.noise[0].rate] = np.nan
    warmer = 2.0 if later else 0.0
    return replace(
        data, name=f"next {axis}", axis=axis, observed=np.zeros(lines.shape, np.complex128),
        before=np.zeros(lines.shape, np.complex128), variance=lines, shown=along, gated=along,
        outliers=np.zeros((len(f), 2)), reference_variance=_reference_noise(data, f, seconds),
        frequency=f, nominal=f, begin=begin, end=np.asarray(begin + seconds, np.float64), index=np.arange(len(f)),
        level=tuple(levels[int(k)] for k in (order // points)), usable=np.ones((len(channels.names), len(f)), np.bool_),
        source=np.interp(f, np.sort(data.frequency), data.source[np.argsort(data.frequency)]),
        scale=np.full(len(f), float(np.median(data.scale[data.scale > 0.0]))),
        temperature=np.linspace(*_range(data.temperature), len(f)) + warmer,
        supply=np.linspace(*_range(data.supply), len(f)), directions=directions(axis), leftovers=(), notes=(),
    )  # fmt: skip


def _range(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[-1])


def _reference_noise(data: SineRecords, f: Array, seconds: float) -> Array:
    """Variance of the reference's lines: that of its velocity is the same at all frequencies."""
    driven = data.frequency > 0.0
    length = float(np.median((data.end - data.begin)[driven]))
    velocity = np.median(data.reference_variance[driven, 1] / (2.0 * math.pi * data.frequency[driven]) ** 2)
    omega = 2.0 * math.pi * np.multiply.outer(f, np.arange(ORDERS))
    return np.asarray(velocity * length / seconds * omega**2)


def _on_turntable(template: Turning) -> Iterator[Option]:
    data = template.data
    axis = ["yaw", "pitch", "roll"][int(np.argmax(np.abs(data.up[[1, 2, 0], 0])))]
    radius = float(data.radius[0])
    wider = 0.1 if radius < 0.08 else 0.05
    minutes = MINUTES_MOUNT + data.observed.shape[1] * data.interval / 60.0
    run = {"procedure": "turntable", "axis": axis, "all": True}
    yield Option("repeat", "more of the same", minutes, run, lambda: Turning(data))
    yield Option(
        "second radius", "what follows the centripetal force parts from what follows the rate squared", minutes,
        {**run, "radius": f"{wider * 1000:g} mm"},
        lambda: Turning(replace(data, radius=np.full_like(data.radius, wider))),
    )  # fmt: skip
    yield Option(
        "turned by 90°", "radial and tangential axes change places", minutes, {**run, "angle": "90°"},
        lambda: Turning(replace(data, outward=_turned(template, 1), tangent=_turned(template, 2))),
    )  # fmt: skip
    for other in [one for one in ("yaw", "pitch", "roll") if one != axis]:
        yield Option(
            f"{other} up", "another gyro takes the rate, another axis gravity", minutes, {**run, "axis": other},
            lambda other=other, axis=axis: Turning(_reaxed(template, axis, other)),  # type: ignore[misc]
        )  # fmt: skip
    later = {"title": "The same run fifteen minutes later", "steps": [{"wait": "900 s"}, run]}
    shifted = replace(data, time=data.time + 900.0, temperature=data.temperature + 2.0)
    yield Option("later", "temperature, supply and time since power-up part", minutes + 15.0, later,
                 lambda: Turning(shifted))  # fmt: skip


def _turned(template: Turning, which: int) -> Array:
    """Outward (1) or tangent (2) of a cube turned by a right angle about the platter's axis."""
    data = template.data
    return data.tangent * -1.0 if which == 1 else data.outward


def _reaxed(template: Turning, axis: str, other: str) -> Any:
    """The same run with another gyro axis on the platter's: case axes in cyclic order."""
    place = {"roll": 0, "yaw": 1, "pitch": 2}
    shift = (place[other] - place[axis]) % 3
    data = template.data
    return replace(data, **{name: np.roll(getattr(data, name), shift, axis=0) for name in ("outward", "tangent", "up")})
