"""A clean world in which a cable, a hand or a channel has gone wrong, for `fast_bench`.

Faults of a channel change what every recorder sees of it; what the operator does wrong changes what was asked for, and
the answer is the same as always. A spike is one sample long. What is said of codes is of the converter's, over ±10 V.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import fast_bench
import numpy as np
from numpy.typing import NDArray

from fixtures.world import World

Array = NDArray[np.float64]
Told = Callable[[str, dict[str, Any]], dict[str, Any] | None]  # what was asked for → what is done; None: nothing
VERTICAL = 2  # cube axis about which poses are turned here
LOW, STEP = -10.0, 20.0 / 65535.0  # V


@dataclass(frozen=True)
class Wrong:
    """`swapped` names two channels; `inverted` sensors have the other sign about their zero; `stuck` at volts; `cut`
    off above or below (V); `spikes`: how many samples of a record stand out, and by how many volts; `gain` of a
    channel about its zero; `told` what the operator makes of a request. `copied` channels see the wire of
    another, noise and all; `hanging` bits of a channel's code always read one; a `loose` channel is at 0 V for that
    share of every second; `drive` is how much of the set level the source gives.
    """

    swapped: tuple[str, str] | tuple[()] = ()
    inverted: frozenset[str] = frozenset()
    stuck: Mapping[str, float] = field(default_factory=dict)
    cut: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    spikes: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    gain: Mapping[str, float] = field(default_factory=dict)
    told: Told | None = None
    copied: Mapping[str, str] = field(default_factory=dict)
    hanging: Mapping[str, int] = field(default_factory=dict)
    loose: Mapping[str, float] = field(default_factory=dict)
    drive: float = 1.0


class WrongWorld(World):
    """See the module."""

    def __init__(self, seed: int, wrong: Wrong, hidden: Sequence[Mapping[str, Any]] = ()) -> None:
        super().__init__({**fast_bench._clean(), "hidden": [dict(one) for one in hidden]}, seed)
        self._wrong, self._random = wrong, np.random.default_rng(seed)

    def volts(self, names: Sequence[str], times: Sequence[Array]) -> list[Array]:
        one, other = self._wrong.swapped or ("", "")
        wired = [self._wrong.copied.get(name, {one: other, other: one}.get(name, name)) for name in names]
        found = super().volts(wired, times)
        for place, signal in enumerate(wired):
            if len(found[first := wired.index(signal)]) == len(found[place]):
                found[place] = found[first]  # one wire has one noise
        return [
            self._spoilt(name, signal, volts, when)
            for name, signal, volts, when in zip(names, wired, found, times, strict=True)
        ]

    def perform(self, action: str, settings: Mapping[str, Any], text: str) -> str:
        told = self._wrong.told
        done = dict(settings) if told is None else told(action, dict(settings))
        return "done" if done is None else super().perform(action, done, text)

    def set_source(self, *, level: float | None = None, **more: Any) -> None:
        super().set_source(level=None if level is None else level * self._wrong.drive, **more)

    def _spoilt(self, name: str, signal: str, volts: Array, when: Array) -> Array:
        wrong, sensor = self._wrong, self.physics.cube.sensors.get(signal)
        zero = 0.0 if sensor is None else sensor.zero
        gain = wrong.gain.get(name, 1.0) * (-1.0 if name in wrong.inverted else 1.0)
        found = zero + gain * (volts - zero)
        if name in wrong.cut:
            found = np.clip(found, *wrong.cut[name])
        if name in wrong.stuck:
            found = np.full_like(found, wrong.stuck[name])
        if name in wrong.spikes and len(found) > 1:
            count, height = wrong.spikes[name]
            found[self._random.integers(1, len(found) - 1, count)] += height
        if name in wrong.loose:
            found = np.where(np.mod(when, 1.0) < wrong.loose[name], 0.0, found)
        if name in wrong.hanging:
            codes = np.rint((np.clip(found, LOW, -LOW) - LOW) / STEP).astype(np.int64)
            found = LOW + (codes | wrong.hanging[name]) * STEP
        return np.asarray(found)


class Poses:
    """An operator who makes something else of the direction that shall be up: of the number of the pose, the direction,
    and the direction that the cube was put down with before.
    """

    def __init__(self, made: Callable[[int, Array, Array], Array]) -> None:
        self._made, self._number, self._last = made, 0, np.array([0.0, 1.0, 0.0])

    def __call__(self, action: str, settings: dict[str, Any]) -> dict[str, Any]:
        if action != "pose":
            return settings
        self._number += 1
        asked = np.array([settings["up_x"], settings["up_y"], settings["up_z"]])
        self._last = self._made(self._number, asked, self._last)
        return dict(zip(("up_x", "up_y", "up_z"), self._last.tolist(), strict=True))


def turned(up: Array, degrees: float) -> Array:
    """A direction turned about the cube's z axis."""
    angle, axis = math.radians(degrees), np.eye(3)[VERTICAL]
    return up * math.cos(angle) + np.cross(axis, up) * math.sin(angle) + axis * (axis @ up) * (1.0 - math.cos(angle))


def mounted(**other: Any) -> Told:
    """An operator who mounts the cube with other settings than asked for; "not" is the opposite of a yes or no."""

    def told(action: str, settings: dict[str, Any]) -> dict[str, Any]:
        if not action.startswith("mount_on_"):
            return settings
        return settings | {key: not settings[key] if value == "not" else value for key, value in other.items()}

    return told
