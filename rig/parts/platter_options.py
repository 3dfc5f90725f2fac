"""Turntable runs that the bench could do next, as they would be recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from rig.motion import Array
from rig.parts.conditions import continued
from rig.parts.part import Option, Part
from rig.parts.platter_records import PlatterRecords

MINUTES_MOUNT = 4.0  # of an operator: mount, cables


def options(data: PlatterRecords, make: Callable[[PlatterRecords], Part]) -> Iterator[Option]:
    """Turntable runs that the bench can do: again, at another radius, turned, with another axis up, later."""
    axis = ["yaw", "pitch", "roll"][int(np.argmax(np.abs(data.up[[1, 2, 0], 0])))]
    radius = float(data.radius[0])
    wider = 0.1 if radius < 0.08 else 0.05
    minutes = MINUTES_MOUNT + data.observed.shape[1] * data.interval / 60.0
    run = {"procedure": "turntable", "axis": axis, "all": True}
    then = _after(data, 60.0 * MINUTES_MOUNT)
    yield Option("repeat", "more of the same", minutes, run, lambda: make(then))
    yield Option(
        "second radius", "what follows the centripetal force parts from what follows the rate squared", minutes,
        {**run, "radius": f"{wider * 1000:g} mm"},
        lambda: make(replace(then, radius=np.full_like(data.radius, wider))),
    )  # fmt: skip
    yield Option(
        "turned by 90°", "radial and tangential axes change places", minutes, {**run, "angle": "90°"},
        lambda: make(replace(then, outward=_turned(data, 1), tangent=_turned(data, 2))),
    )  # fmt: skip
    for other in [one for one in ("yaw", "pitch", "roll") if one != axis]:
        yield Option(
            f"{other} up", "another gyro takes the rate, another axis gravity", minutes, {**run, "axis": other},
            lambda other=other, axis=axis: make(_reaxed(then, axis, other)),  # type: ignore[misc]
        )  # fmt: skip
    later = {"title": "The same run fifteen minutes later", "steps": [{"wait": "900 s"}, run]}
    yield Option("later", "temperature, supply and time since power-up part", minutes + 15.0, later,
                 lambda: make(_after(data, 900.0)))  # fmt: skip


def _after(data: PlatterRecords, pause: float) -> PlatterRecords:
    """The same run so many seconds after this one has ended."""
    time = data.time + float(np.ptp(data.time)) + pause
    temperature, supply = (continued(data.time, one, time) for one in (data.temperature, data.supply))
    return replace(data, time=time, temperature=temperature, supply=supply)


def _turned(data: PlatterRecords, which: int) -> Array:
    """Outward (1) or tangent (2) of a cube turned by a right angle about the platter's axis."""
    return data.tangent * -1.0 if which == 1 else data.outward


def _reaxed(data: PlatterRecords, axis: str, other: str) -> PlatterRecords:
    """The same run with another gyro axis on the platter's: case axes in cyclic order."""
    place = {"roll": 0, "yaw": 1, "pitch": 2}
    shift = (place[other] - place[axis]) % 3
    return replace(data, **{name: np.roll(getattr(data, name), shift, axis=0) for name in ("outward", "tangent", "up")})
