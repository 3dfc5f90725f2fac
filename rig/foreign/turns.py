"""Poses whose gyros turned with them: between two poses at rest gravity turns in the case as the gyros say.

With rates ω in the case, and no zeros, what points up in the case turns by −ω:  u₂ = R⁻¹·u₁,  R = Π exp([ω·Δt]×).
An axis of the accelerometers that counts the other way makes a left-handed triad of them; u₂ then comes out as if the
gyros of both other axes did. Any signed permutation of the gyros that is right-handed may as well be one of the
accelerometers, its inverse, either way round.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rig.foreign import frames
from rig.foreign.finding import Finding, runs
from rig.foreign.frames import Triad
from rig.foreign.pairs import running
from rig.foreign.tables import Array, Foreign, Table

BLOCK = 0.25  # s, of which it is asked whether the case stood still
STILL = 4.0  # times the scatter of the quietest tenth of the blocks
QUIET = 0.1
LONGEST = 60.0  # s between two poses
TURNED = math.radians(20.0)  # a pair of poses that says something
FEWEST = 3  # such pairs
WRONG = math.radians(25.0)  # rms between gravity and what the gyros say
FITS = 0.4  # of it, that is left where another reading of the channels explains it
SPHERE, LARGEST_ZERO = 9, 0.3  # poses that tell the zeros of a triad, and how large those may be, of gravity
FACTORS = (0.3, 3.0)  # of all gyros alike: a sensitivity that is not the stated one
LIKELIER = 0.7  # a unit or a sign that leaves this share more is believed before a factor
UNITS = (("°/s", math.pi / 180.0), ("rad/s", 180.0 / math.pi))


@dataclass(frozen=True)
class _Turns:
    """What gravity did between poses: directions before and after (n, 3), and steps ω·Δt of each turn, rad (m, 3)."""

    before: Array
    after: Array
    steps: tuple[Array, ...]

    def error(self, way: Array, factor: float) -> float:
        """rms angle between gravity and what the gyros say, rad, if they show `way` (3, 3) of what they should and the
        rates are `factor` times theirs.
        """
        turned = np.array([_up_after(u, factor * one @ way) for u, one in zip(self.before, self.steps, strict=True)])
        return math.sqrt(float(np.mean(np.arccos(np.clip(np.sum(turned * self.after, axis=1), -1.0, 1.0)) ** 2)))


def findings(data: Foreign, table: Table) -> Iterator[Finding]:
    """Gyros that contradict gravity, in a file of poses with a triad of either."""
    forces, rates = frames.triads(data.manifest, "acceleration"), frames.triads(data.manifest, "rate")
    if data.manifest.kind != "poses" or not forces or not rates or data.manifest.time is None:
        return
    force, rate = forces[0], rates[0]
    turns = _between(data, table, force, rate)
    if turns is None:
        return
    stated = turns.error(np.eye(3), 1.0)
    if stated < WRONG:
        return
    axes = {_said(force, rate, way): turns.error(way, 1.0) for way in frames.READINGS[1:]}
    errors = axes | {words: turns.error(way, factor) for words, way, factor in _in_other_units(force, rate)}
    words, error = _larger(turns)
    errors[words] = error / LIKELIER
    best = min(errors, key=lambda one: errors[one])
    fits = errors[best] < FITS * stated
    why = f"it would fit with {best} ({math.degrees(errors[best]):.0f}°)" if fits else "no sign and no unit explains it"
    yield Finding(
        "frame" if fits and best in axes else "turns", table.label,
        f"the turns between {len(turns.steps)} pairs of poses contradict gravity: what the gyros say is "
        f"{math.degrees(stated):.0f}° off (rms); {why}",
    )  # fmt: skip


def _larger(turns: _Turns) -> tuple[str, float]:
    """The factor of all gyros that fits best, in words, and what it leaves, rad."""
    from scipy.optimize import minimize_scalar

    tried = np.geomspace(*FACTORS, 17)
    errors = [turns.error(np.eye(3), float(one)) for one in tried]
    near = tried[max(int(np.argmin(errors)) - 1, 0)], tried[min(int(np.argmin(errors)) + 1, len(tried) - 1)]
    found = minimize_scalar(lambda one: turns.error(np.eye(3), float(one)), bounds=near, method="bounded")
    return f"rates {float(found.x):.3g} times what is stated", float(found.fun)


def _in_other_units(force: Triad, rate: Triad) -> Iterator[tuple[str, Array, float]]:
    """Other units of the gyros, and perhaps signs besides: in words, how they are read, and a factor."""
    for unit, factor in UNITS:
        for signs in itertools.product((1.0, -1.0), repeat=3) if rate[0].unit != unit else ():
            words = f"the gyros in {unit} instead of {rate[0].unit}"
            also = f", and {_said(force, rate, np.diag(signs))}" if min(signs) < 0.0 else ""
            yield words + also, np.diag(signs), factor


def _said(force: Triad, rate: Triad, way: Array) -> str:
    """A reading of the gyros in words, or of the accelerometers, which it may be as well."""
    back = [k for k in range(3) if way[k, k] < 0.0]
    if np.count_nonzero(np.diag(way)) < 3:
        said = [frames.in_words(rate, way)]
        if np.linalg.det(way) > 0.0:
            said.append(frames.in_words(force, min((way.T, -way.T), key=frames.moved)))
        return ", or ".join(said)
    if len(back) == 3:
        return "the gyros counting the other way, all three"
    if len(back) == 2:
        (left,) = set(range(3)) - set(back)
        gyros = " and ".join(rate[k].channel for k in back)
        return f"{force[left].channel} counting the other way (a left-handed triad), or {gyros}"
    return f"{rate[back[0]].channel} counting the other way"


def _between(data: Foreign, table: Table, force: Triad, rate: Triad) -> _Turns | None:
    rows, time = running(data, table)
    values = np.column_stack([data.si(table, one)[rows] for one in (*force, *rate)])
    whole = np.isfinite(values).all(axis=1)
    values, time = values[whole], time[whole]
    if len(time) < 100:
        return None
    step = float(np.median(np.diff(time)))
    size = max(4, round(BLOCK / step))
    rests = _rests(values, size)
    found = []
    for (_, end, up, zero), (begin, _, after, later) in itertools.pairwise(rests):
        moved = slice(end - size // 2, begin + size // 2)
        steps = np.diff(time[moved], prepend=time[moved][0])
        turned = float(np.arccos(np.clip(up @ after, -1.0, 1.0)))
        if turned > TURNED and time[begin] - time[end - 1] < LONGEST and float(steps.max()) < 10.0 * step:
            found.append((up, after, (values[moved, 3:] - 0.5 * (zero + later)) * steps[:, None]))
    if len(found) < FEWEST:
        return None
    return _Turns(np.array([one[0] for one in found]), np.array([one[1] for one in found]), tuple(o[2] for o in found))


def _rests(values: Array, size: int) -> list[tuple[int, int, Array, Array]]:
    """Stretches at rest, two blocks at least: rows from and to, the direction up (3,) and the means of the gyros."""
    count = len(values) // size
    blocks = values[: count * size].reshape(count, size, 6)
    quiet = np.ones(count, np.bool_)
    for columns in (slice(0, 3), slice(3, 6)):
        scatter = np.sqrt(np.sum(np.var(blocks[:, :, columns], axis=1), axis=1))
        quiet &= scatter < STILL * max(float(np.quantile(scatter, QUIET)), 1e-12)
    spans = [(first, first + length) for first, length in runs(quiet) if length >= 2]
    means = np.array([blocks[b:e].mean(axis=(0, 1)) for b, e in spans]).reshape(-1, 6)
    up = means[:, :3] - _zero(means[:, :3])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return [(b * size, e * size, up[k], means[k, 3:]) for k, (b, e) in enumerate(spans)]


def _zero(force: Array) -> Array:
    """Zeros of a triad (3,) from poses (n, 3) all over the sphere:  |f|² = 2·f·zero + const;  none from few of them."""
    if len(force) < SPHERE:
        return np.zeros(3)
    solution, _, rank, sizes = np.linalg.lstsq(
        np.column_stack([2.0 * force, np.ones(len(force))]), np.sum(force**2, axis=1)
    )
    spread = rank == 4 and sizes[-1] > 0.05 * sizes[0] / np.abs(force).max()
    small = float(np.linalg.norm(solution[:3])) < LARGEST_ZERO * float(np.median(np.linalg.norm(force, axis=1)))
    return np.asarray(solution[:3]) if spread and small else np.zeros(3)


def _up_after(up: Array, steps: Array) -> Array:
    """What was up (3,), in a case that has turned by small steps (m, 3) one after the other."""
    angle = np.linalg.norm(steps, axis=1, keepdims=True)
    axis = steps / np.where(angle > 0.0, angle, 1.0)
    turns = np.concatenate([np.cos(0.5 * angle), -axis * np.sin(0.5 * angle)], axis=1)
    while len(turns) > 1:  # the later one from the left: u₂ = q_m* … q_1* u₁ …
        if len(turns) % 2:
            turns = np.concatenate([turns, [[1.0, 0.0, 0.0, 0.0]]])
        turns = _product(turns[1::2], turns[0::2])
    w, v = turns[0, 0], turns[0, 1:]
    return np.asarray(up + 2.0 * np.cross(v, np.cross(v, up) + w * up))


def _product(one: Array, other: Array) -> Array:
    """Products of quaternions, scalar first, (n, 4)."""
    w, v, w2, v2 = one[:, :1], one[:, 1:], other[:, :1], other[:, 1:]
    scalar = w * w2 - np.sum(v * v2, axis=1, keepdims=True)
    return np.concatenate([scalar, w * v2 + w2 * v + np.cross(v, v2)], axis=1)
