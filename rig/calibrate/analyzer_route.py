"""The second route from one sweep: the analyzer's responses at the bench, beside the records' evaluation off-line.

Both routes look at one motion through one vibrometer, so its gain, the decoder's delay, the filter and the alignment
are the same error in both and cancel in the difference. What does not cancel: the noise that each of them saw, and how
well the analyzer's two inputs match.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.archive.records import Recorded
from rig.calibrate import accelerometers
from rig.calibrate.accelerometers import SENSITIVITY, ChannelFit, Observed, Setup
from rig.calibrate.budget import Budget, Contribution, half_width
from rig.calibrate.calibration import AnalyzerPoint, Check, Result, not_determined
from rig.errors import BadInput
from rig.parts.reading.analyzer_response import Answer, answers
from rig.parts.reading.vibration import Chain, chain_of
from rig.sensor import Sensor

MEASURAND, TITLE = "sensitivity_analyzer", "sensitivity at low frequency, by the analyzer"
MATCH_GAIN = 10.0 ** (0.25 / 20.0) - 1.0  # limit; ± 0.25 dB between the inputs (HP 89441A Technical Data)
MATCH_PHASE = math.radians(2.0)  # limit, same place
MATCH_SOURCE = "data sheet: ± 0.25 dB, ± 2° between the inputs"
NEAR = 8  # points around each frequency that say together how much noise there is
SHARED = ("repeatability across remounts",)  # of type A, and still the same in both routes: the same mountings


@dataclass(frozen=True)
class SecondRoute:
    """The analyzer's answers of all sweeps by channel, usable and not, and the chain of the reference."""

    sensor: Sensor
    setup: Setup
    answers: Mapping[str, tuple[Answer, ...]]

    def results(self, offline: Sequence[Result]) -> Iterator[Result]:
        """A sensitivity for every channel that the analyzer saw, beside the one from the records."""
        known = {one.channel: one for one in offline if one.measurand == "sensitivity" and one.determined}
        for channel in self.answers:
            yield self._result(channel, known.get(channel))

    def _result(self, channel: str, offline: Result | None) -> Result:
        good, left_out = self._good(channel), self._left_out(channel)
        try:
            fit = self._fit(channel, good)
            match = tuple(self._match(fit))
        except BadInput as error:
            return not_determined(channel, MEASURAND, TITLE, SENSITIVITY, "; ".join([str(error), *left_out]))
        single = accelerometers.sensitivity_result(fit, self.setup, None, self.sensor.channel(channel).drift)
        lines = [*single.contributions, *match]
        found = replace(
            single,
            measurand=MEASURAND,
            title=TITLE,
            budget=Budget(tuple(_named(line) for line in lines)),
            method=f"response of {len(good)} sines by the analyzer (H1, coherence), one-pole response, weighted least "
            "squares",
            remarks=(*single.remarks, *left_out),
        )
        return found if offline is None else compared(found, offline)

    def _good(self, channel: str) -> list[Answer]:
        return [one for one in self.answers[channel] if not one.flags]

    def _left_out(self, channel: str) -> list[str]:
        bad = [one for one in self.answers[channel] if one.flags]
        said = sorted({flag.partition(" (")[0] for one in bad for flag in one.flags})
        return [f"{len(bad)} of {len(self.answers[channel])} points left out: {', '.join(said)}"] if bad else []

    def _fit(self, channel: str, good: Sequence[Answer]) -> ChannelFit:
        seen = observed(good, channel)
        return accelerometers.fit_channel(seen, channel, self.setup.chain, self.sensor.channel(channel).bandwidth)

    def _match(self, fit: ChannelFit) -> Iterator[Contribution]:
        """What a mismatch of the two inputs does: a gain multiplies S, a phase moves what the fit makes of it."""
        chain, pole = self.setup.chain, self.sensor.channel(fit.channel).bandwidth
        turned = replace(fit.seen, response=fit.seen.response * np.exp(1j * MATCH_PHASE))
        moved = accelerometers.fit_channel(turned, fit.channel, chain, pole).sensitivity - fit.sensitivity
        size = half_width(MATCH_GAIN, "rectangular")
        yield Contribution(
            "analyzer's inputs, gain", "B", "rectangular", size, "1", fit.sensitivity, source=MATCH_SOURCE
        )
        yield Contribution(
            "analyzer's inputs, phase", "B", "rectangular", half_width(MATCH_PHASE, "rectangular"), "rad",
            moved / MATCH_PHASE, source=MATCH_SOURCE,
        )  # fmt: skip

    def responses(self) -> dict[str, tuple[AnalyzerPoint, ...]]:
        """Every point that was used or left out, lowest frequency first."""
        return {
            channel: tuple(_point(one, self.setup.chain) for one in sorted(several, key=_order))
            for channel, several in self.answers.items()
        }

    def flags(self) -> Iterator[str]:
        """Points that were left out."""
        for several in self.answers.values():
            for one in several:
                for flag in one.flags:
                    where = f"{one.run}, {one.frequency:.4g} Hz {one.level}"
                    yield f"{where}: analyzer, {flag}; its response was left out"


def second_route(runs: Sequence[Recorded], sensor: Sensor, setup: Setup | None) -> SecondRoute | None:
    """The analyzer's answers of all sweeps; None where it kept none, or without a reference (`setup`)."""
    if setup is None:
        return None
    found: dict[str, list[Answer]] = {}
    for records in runs:
        if any("frequency" in body and "response" in body for body in records.points.values()):
            for one in answers(records, chain_of(records), sensor):
                found.setdefault(one.channel, []).append(one)
    return SecondRoute(sensor, setup, {name: tuple(several) for name, several in found.items()}) if found else None


def observed(good: Sequence[Answer], channel: str) -> Observed:
    """Responses with the noise that they show together; raises BadInput if there are fewer than two.

    The coherence of two averages scatters so much that the best of them by chance would carry all the weight.
    """
    if len(good) < 2:
        raise BadInput(f"{channel}: found {len(good)} usable points of the analyzer, wanted at least two")
    peak = np.array([one.peak for one in good])
    response = np.array([one.response for one in good])
    noise = _smooth([one.frequency for one in good], [one.noise for one in good])
    averages = np.array([one.averages for one in good])
    return Observed(
        frequency=np.array([one.frequency for one in good]),
        response=response,
        u_relative=np.sqrt(noise / (2.0 * averages)) / (np.abs(response) * peak),
        peak=peak,
        run=tuple(one.run for one in good),
        noise_dof=2.0 * float(min(NEAR, len(good))) * float(np.mean(averages - 1)),
    )


def _smooth(frequency: Sequence[float], noise: Sequence[float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Mean of the nearest points by the logarithm of frequency."""
    at, power = np.log(np.array(frequency)), np.array(noise)
    nearest = np.argsort(np.abs(at[:, None] - at[None, :]), axis=1, kind="stable")[:, :NEAR]
    return np.asarray(power[nearest].mean(axis=1), np.float64)


def _named(line: Contribution) -> Contribution:
    """The noise that the analyzer saw is not the records' noise."""
    if line.kind == "B":
        return line
    return replace(line, name="noise of the responses", source="coherence, points nearby together")


def compared(found: Result, offline: Result) -> Result:
    """The analyzer's result with the one from the records beside it; flagged if they are further apart than 2·u(Δ)."""
    delta = float(found.value or 0.0) - float(offline.value or 0.0)
    check = Check(f"off-line: {offline.method}", float(offline.value or 0.0), offline.u, delta, apart(found, offline))
    if check.agrees:
        return replace(found, check=check)
    said = (
        f"the value from the records lies {abs(delta) / check.u_delta:.1f} standard uncertainties of the difference "
        "away, wanted 2 at most"
    )
    return replace(found, check=check, status="flagged", remarks=(said, *found.remarks))


def apart(one: Result, other: Result) -> float:
    """Standard uncertainty of the difference of two results of one sweep: what they share cancels."""
    first, second = _by_origin(one, "one"), _by_origin(other, "other")
    return math.sqrt(sum((first.get(o, 0.0) - second.get(o, 0.0)) ** 2 for o in first.keys() | second.keys()))


def _by_origin(result: Result, own: str) -> dict[tuple[str, ...], float]:
    return {
        (c.name, c.source) if c.kind == "B" else (own, c.name): c.contribution
        for c in result.contributions
        if c.name not in SHARED
    }


def _order(one: Answer) -> tuple[float, float]:
    return one.frequency, -one.peak


def _point(one: Answer, chain: Chain) -> AnalyzerPoint:
    magnitude = abs(one.response)
    slope = complex(chain.phase_per_cutoff(np.array([one.frequency]))[0]) * chain.u_cutoff
    gain = (chain.gain.u / chain.gain.value, slope.real, chain.time_base.u, half_width(MATCH_GAIN, "rectangular"))
    delay = 2.0 * math.pi * one.frequency * chain.delay.u
    return AnalyzerPoint(
        frequency=one.frequency,
        level=one.level,
        acceleration=one.peak,
        magnitude=magnitude,
        phase=math.atan2(one.response.imag, one.response.real),
        u_magnitude=magnitude * one.u_relative,
        u_phase=one.u_relative,
        uc_magnitude=magnitude * math.hypot(one.u_relative, *gain),
        uc_phase=math.hypot(one.u_relative, delay, slope.imag, half_width(MATCH_PHASE, "rectangular")),
        coherence=one.coherence,
        run=one.run,
        flags=one.flags,
    )
