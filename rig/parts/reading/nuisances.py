"""What is known of the bench only within a stated uncertainty: adjusted together with every model, never named missing.

They are effects like those of the shelf, with a prior: the vibrometer's gain, the decoder's delay and the low-pass
filter's cut-off on the shaker, the first two orders of the encoder's graduation on the turntable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rig.archive.records import Recorded, reference
from rig.errors import BadInput
from rig.model import Array, Complexes, Coordinate, Effect, Motion, Parameter, Term, Values
from rig.parts.reading.vibration import Chain, chain_of
from rig.shelf import effect_of, nothing_of

U_GRAVITY_ANGLE = 0.3  # rad
U_PLACE_ANGLE = 0.3  # rad
U_BEND = 0.01  # relative, at the end of the band


class FilterCutoff(Effect):
    """The reference's low-pass filter is not quite where its verification puts it."""

    stage = "reference"
    title = "cut-off of the reference's low-pass filter"
    equation = "a_true = a_shown·H(f; cutoff)/H(f; cutoff·(1 + relative))"
    places = ("shaker",)
    coordinates = (Coordinate("relative", 1e-3),)
    parameters = (Parameter("relative", "1", (-0.2, 0.2), (1e-4, 3e-2)),)
    missing = "phase of the reference ∝ f, a little bent towards the cut-off"
    separate_by = "verification of the filter with the analyzer"
    source = "error sources L10"

    def __init__(self, chain: Chain) -> None:
        self.name, self._chain = "filter_cutoff", chain  # type: ignore[misc]

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        return np.asarray(along * (1.0 + at["relative"] * self._chain.phase_per_cutoff(frequency)))


class VibrometerGain(Effect):
    """The vibrometer's gain is not quite what its certificate says: every acceleration is off by the same share."""

    name = "vibrometer_gain"
    stage = "reference"
    title = "gain of the vibrometer"
    equation = "a_true = a_shown/(1 + relative)"
    places = ("shaker",)
    coordinates = (Coordinate("relative", 1e-3),)
    parameters = (Parameter("relative", "1", (-0.5, 0.5), (1e-3, 1e-2)),)
    missing = "nothing by itself: the sensitivities take it up; sizes in m/s² are uncertain by it"
    separate_by = "another reference: gravity, or a standard accelerometer"
    source = "error sources L02, U1"

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        return along / (1.0 + at["relative"])


class GravityAngle(Effect):
    """An axis that lies level is turned by an angle that nobody stated: where gravity points at the encoder's zero."""

    name = "gravity_angle"
    stage = "motion"
    title = "angle of gravity at the encoder's zero"
    equation = "f = R(axis, angle)·f_shown"
    places = ("rotation",)
    coordinates = (Coordinate("angle", 1e-3),)
    parameters = (Parameter("angle", "rad", (-math.pi, math.pi), (0.0, 0.1)),)
    missing = "one part in each accelerometer across the axis, a quarter of a turn from its own"
    separate_by = "the case level at a known angle"
    source = "gravity in the turning case"

    def __init__(self, axis: int) -> None:
        self._axis = axis

    def motion(self, motion: Motion, at: Values) -> Motion:
        first, second = (self._axis + 1) % 3, (self._axis + 2) % 3
        c, s = math.cos(at["angle"]), math.sin(at["angle"])
        moved = {}
        for name in ("force", "up"):
            vector = np.array(getattr(motion, name))
            one, other = vector[first].copy(), vector[second].copy()
            vector[first], vector[second] = c * one - s * other, s * one + c * other
            moved[name] = vector
        return Motion(**{**vars(motion), **moved})


class CasePlace(Effect):
    """Where a case sits beside the axis: the length and the direction of its radius are known only about."""

    name = "case_place"
    stage = "motion"
    title = "place of the case beside the axis"
    equation = "f += −ω²·Δ(r·outward) + α·Δ(r·tangent)"
    places = ("rotation",)
    missing = "part of the acceleration along the radius in the accelerometer along the tangent, and the other way"
    separate_by = "the case on a mark of the platter, its radius measured"
    source = "centripetal and tangential acceleration"

    def __init__(self, axis: int, radius: float, prior: Values) -> None:
        self._axis, self._radius = axis, radius
        self.coordinates = tuple(Coordinate(name, 1e-3) for name in prior)  # type: ignore[misc]
        units = {"angle": "rad", "length": "m"}
        self.parameters = tuple(  # type: ignore[misc]
            Parameter(name, units[name], (-math.pi, math.pi), (0.0, 0.1)) for name in prior
        )

    def motion(self, motion: Motion, at: Values) -> Motion:
        angle, radius = at.get("angle", 0.0), self._radius + at.get("length", 0.0)
        out, along = radius * math.cos(angle) - self._radius, radius * math.sin(angle)
        outward = out * motion.outward + along * motion.tangent
        tangent = out * motion.tangent - along * motion.outward
        squares = np.sum(motion.rate**2, axis=0)
        return motion.with_force(tangent * motion.turning[self._axis] - outward * squares)


class ReferenceBend(Effect):
    """A smoothed reference keeps the motion to a per cent at the end of the band: its response bends a little."""

    name = "reference_bend"
    stage = "reference"
    title = "response of the reference at the end of the band"
    equation = "H = 1 + relative·(f/band)²"
    places = ("rotation", "free")
    coordinates = (Coordinate("relative", 1e-3),)
    parameters = (Parameter("relative", "1", (-0.2, 0.2), (1e-4, 0.02)),)
    missing = "gain of every channel ∝ f² by a per cent at the end of the band, without phase"
    separate_by = "a reference that is sampled faster"
    source = "smoothing of tracks: kept to 99 % at the band's end"

    def __init__(self, band: float) -> None:
        self._band = band

    def motion(self, motion: Motion, at: Values) -> Motion:
        if not at["relative"]:
            return motion

        def bent(frequency: Array) -> Complexes:
            return np.asarray(1.0 + at["relative"] * (frequency / self._band) ** 2, np.complex128)

        names = ("force", "rate", "turning")
        moved = {n: np.asarray(motion.grid.observed(getattr(motion, n), bent), np.float64) for n in names}
        return Motion(**{**vars(motion), **moved})


def of_track(band: float) -> list[Term]:
    """What the smoothing of a track may do at the end of the compared band (Hz)."""
    return [Term(ReferenceBend(band), None, {"relative": 0.0}, {"relative": U_BEND})]


def of_rotation(axis: int) -> list[Term]:
    """Where gravity lies, found from the accelerometers themselves and so known only about."""
    return [Term(GravityAngle(axis), None, {"angle": 0.0}, {"angle": U_GRAVITY_ANGLE})]


def of_place(axis: int, radius: float, prior: Values) -> list[Term]:
    """What is known only about of a case beside the axis: its `angle` (rad), its `length` (m), or both."""
    return [Term(CasePlace(axis, radius, prior), None, dict.fromkeys(prior, 0.0), prior)] if prior else []


def of_shaker(runs: Sequence[Recorded]) -> list[Term]:
    """Gain, decoder delay and cut-off, with the uncertainty of the least sure run."""
    chains = [chain_of(run) for run in runs]
    widest = max(chains, key=lambda chain: chain.u_cutoff)
    delay = nothing_of(effect_of("ldv_delay"), None)
    gain = widest.gain.u / widest.gain.value
    found = [
        Term(VibrometerGain(), None, {"relative": 0.0}, {"relative": gain}),
        Term(delay.effect, None, delay.at, {"time": widest.delay.u}),
    ]
    if widest.u_cutoff > 0.0:
        found.append(Term(FilterCutoff(widest), None, {"relative": 0.0}, {"relative": widest.u_cutoff}))
    return found


def of_turntable(runs: Sequence[Recorded]) -> list[Term]:
    """The first two orders of the graduation, within its stated uncertainty."""
    try:
        u = reference(runs[0], "encoder", "graduation").u
    except BadInput:
        return []
    found = []
    for name in ("encoder_eccentricity", "encoder_second_harmonic"):
        term = nothing_of(effect_of(name), None)
        found.append(Term(term.effect, None, term.at, dict.fromkeys(term.at, u)))
    return found
