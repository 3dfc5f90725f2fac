"""The gain of somebody else's reference, known only within what its owner states: one number for all rows of it.

True motion is shown motion ÷ (1 + relative). With one reference nothing but the prior says what `relative` is, so that
every sensitivity compared with it is as uncertain as it, whatever the number of rows; noise and misfit stay as they
are. The data sheet's tolerance does not say it either: it is for channels that nothing moved, and is taken to be wider
than the reference, or half of a 5 % reference and a 5 % data sheet would pass for knowledge.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from rig.foreign.manifest import Column
from rig.foreign.tables import Foreign
from rig.model import Array, Channels, Complexes, Coordinate, Effect, Motion, Parameter, Term, Values

SHEET = 10.0  # times the reference's uncertainty that a data sheet's tolerance is worth at best beside it


class ReferenceGain(Effect):
    """The gain of one reference, for the parts that it was used for.

    An angle's is about the middle of its record: where it counts zero is another matter. Of positions only the
    acceleration is too large, gravity and attitude are not: f = g·up + (f_shown − g·up)/(1 + relative).
    """

    stage = "reference"
    title = "gain of the reference"
    equation = "a_true = a_shown/(1 + relative), θ_shown = θ + relative·(θ − θ_mean)"
    coordinates = (Coordinate("relative", 1e-3),)
    parameters = (Parameter("relative", "1", (-0.5, 0.5), (1e-3, 1e-2)),)
    missing = "nothing by itself: the sensitivities take it up"
    separate_by = "another reference: gravity, or a whole turn against a stop"
    source = "stated by the owner of the data"

    def __init__(self, channel: str, place: str, parts: Iterable[str]) -> None:
        self.channel = channel
        self.name, self.places, self.parts = f"gain of {channel}", (place,), frozenset(parts)  # type: ignore[misc]

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        return along / (1.0 + at["relative"])

    def turned(self, angle: Array, at: Values) -> tuple[Array, Array, Array]:
        relative = at["relative"]
        return relative * (angle - angle.mean()), np.full_like(angle, relative), np.zeros_like(angle)

    def motion(self, motion: Motion, at: Values) -> Motion:
        if self.places != ("free",) or not at["relative"]:
            return motion
        still = motion.gravity * motion.up
        return replace(motion, force=still + (motion.force - still) / (1.0 + at["relative"]))


def gains_of(foreign: Foreign, experiment: str, parts: Sequence[str]) -> list[Term]:
    """Gains of the references of an imported run, each within what is stated; the three positions have one."""
    stated = {_called(one): one.gain_uncertainty for one in foreign.manifest.columns if one.gain_uncertainty}
    return [
        Term(ReferenceGain(name, experiment, parts), None, {"relative": 0.0}, {"relative": u})
        for name, u in stated.items()
    ]


def _called(column: Column) -> str:
    return "the positions" if column.quantity == "position" else column.channel


def channels_beside(foreign: Foreign, channels: Channels) -> Channels:
    """Channels with tolerances that do not vouch for the reference."""
    made = foreign.manifest
    u = max((one.gain_uncertainty or 0.0 for one in made.columns), default=0.0)
    here = channels.of("acceleration" if made.kind == "motion" else None)
    tolerance = channels.tolerance.copy()
    tolerance[here] = np.hypot(tolerance[here], SHEET * u)
    return replace(channels, tolerance=tolerance) if u else channels


def shared(terms: Sequence[Term]) -> list[Term]:
    """The same with references of several runs as one where they have one name and one uncertainty.

    What is systematic in each run is so in all of them: repeating does not make it smaller.
    """
    found: dict[tuple[object, ...], Term] = {}
    for number, term in enumerate(terms):
        effect = term.effect
        if not isinstance(effect, ReferenceGain):
            found[number,] = term
            continue
        key = (effect.name, *effect.places, *term.prior.values())
        parts = effect.parts | (found[key].effect.parts if key in found else frozenset())
        found[key] = replace(term, effect=ReferenceGain(effect.channel, effect.places[0], parts))
    return list(found.values())
