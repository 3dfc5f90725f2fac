"""Results against what is declared: first whether they can be what they are called, then sign, then size.

A sign is a declared property: what answers with the other one fails, however well its size fits. A wire that shows
nothing of the motion, or of another axis as much as of its own, is no sensor with a small sensitivity or a large
cross-coupling but another sensor, or the cube stands another way. Where several units fail by one factor it is not
they that have changed. What else is said of a channel that may be another is flagged.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from rig.calibrate.calibration import COMBINED, SIGN_REVERSED, Calibration, Result, rejected, text
from rig.calibrate.verdict import verdict
from rig.printed import SHOWN
from rig.sensor import Sensor, SensorChannel

COUPLING = ("cross_axis_", "cross_coupling_")
MOST_COUPLING = 0.5  # of what a channel shows along its own axis; real ones are below a tenth
FAINT = 0.2  # of the declared sensitivity
NOISY = 1.5  # times the noise of the data sheet, or less than its part: no part of the kind is so far off
NOISE = ("deviation", "noise_density", "bias_instability", "random_walk", "noise_bandwidth")
ALIKE = 0.05  # relative: how far factors differ that are one and the same, with units within their own tolerances
SENSITIVITIES = ("sensitivity", "sensitivity_analyzer", "sensitivity_gravity", "sensitivity_centripetal")


def judged(result: Result, nominal: float, tolerance: float | None) -> Result:
    """A sensitivity with its verdict against the declared one, guard band U; other results as they are.

    `nominal` in the result's unit, with its sign; `tolerance` relative, None if none is stated. The sensitivity proper
    and that of all references are always judged, other routes to it (gravity, ω²r, the analyzer) only speak up where
    they fail.
    """
    if result.measurand not in (COMBINED, *SENSITIVITIES) or result.value is None:
        return result
    if result.value * nominal < 0.0 and abs(result.value) > result.expanded:
        return replace(result, verdict="fail", remarks=(_reversed(result, nominal), *result.remarks))
    if tolerance is None:
        return result
    low, high = sorted(nominal * (1.0 + sign * tolerance) for sign in (-1.0, 1.0))
    said = verdict(result.value, result.expanded, low, high)
    if result.status == "flagged":
        said = "inconclusive"  # a model that leaves something over says nothing about limits
    if result.measurand not in (COMBINED, "sensitivity") and said != "fail":
        return result
    return replace(result, low=low, high=high, verdict=said)


def _reversed(result: Result, nominal: float) -> str:
    unit, factor = SHOWN.get(result.unit, (result.unit, 1.0))
    declared = f"{nominal * factor:.4g}" + (f" {unit}" if unit != "1" else "")
    return f"{SIGN_REVERSED}: found {text(result)}, declared is {declared}"


def believed(results: Iterable[Result], sensor: Sensor) -> Iterator[Result]:
    """The results judged against the sensor file; those that cannot be what they are called without their value."""
    rows = [_judged_by(result, sensor) for result in results]
    groups = list(_groups(rows, sensor))
    suspected = {key: why for group in groups for key, why in _common(group, sensor).items()}
    doubted = {key: why for group in groups for key, why in _drawn_in(group, sensor).items()}
    rows = [refused(row, suspected[row.key]) if row.key in suspected else row for row in rows]
    rows = [_flagged(row, doubted[row.key]) if row.key in doubted else row for row in rows]
    noisy, others = dict(_noisy(rows, sensor)), dict(_others(rows, sensor))
    shown = {row.channel for row in rows if row.measurand in SENSITIVITIES and row.determined}
    for row in rows:
        if row.channel in others or (row.channel in noisy and row.channel not in shown):
            yield _flagged(row, f"may be another channel: {others.get(row.channel) or noisy[row.channel]}")
        else:
            yield _flagged(row, noisy[row.channel]) if row.channel in noisy and row.measurand in NOISE else row


def _others(rows: Iterable[Result], sensor: Sensor) -> Iterator[tuple[str, str]]:
    """Channels whose sensitivity says that they are others, and how."""
    for row in rows:
        if row.measurand not in SENSITIVITIES or row.channel not in sensor:
            continue
        times = (row.value or 0.0) / sensor.channel(row.channel).nominal
        if row.rejected:
            yield row.channel, f"{row.measurand} cannot be believed"
        elif row.value is not None and abs(row.value) <= row.expanded:
            yield row.channel, f"{row.measurand} cannot be told from none"
        elif row.verdict == "fail" and times > 0.0:
            yield row.channel, f"{row.measurand} is {times:.3g} times the declared one"


def _noisy(rows: Iterable[Result], sensor: Sensor) -> Iterator[tuple[str, str]]:
    """Channels whose noise is not that of their data sheet, and by how much."""
    for row in rows:
        if row.measurand != "noise_density" or row.value is None or row.channel not in sensor:
            continue
        sheet = sensor.channel(row.channel).noise
        times = 1.0 if sheet is None else math.sqrt(2.0) * row.value / sheet.density
        u = row.expanded / row.value * times
        if not 1.0 / NOISY - u < times < NOISY + u:
            yield row.channel, f"its noise is {times:.3g} times that of its data sheet"


def _flagged(row: Result, why: str) -> Result:
    if not row.determined or row.status != "determined":
        return row
    return replace(row, status="flagged", remarks=(*row.remarks, why))


def like_sensors(calibration: Calibration) -> list[list[str]]:
    """Channels with a sensitivity, of one axis and of declared sensitivities within their tolerance: swapped, each has
    the other's value, and nothing tells.
    """
    shown = {row.channel for row in calibration.results if row.determined and row.measurand.startswith("sensitivity")}
    groups: list[list[SensorChannel]] = []
    for one in Sensor.stated(calibration.unit).channels:
        if one.name in shown:
            like = next((group for group in groups if _like(group[0], one)), None)
            groups.append([one]) if like is None else like.append(one)
    return [[one.name for one in group] for group in groups if len(group) > 1]


def _like(one: SensorChannel, other: SensorChannel) -> bool:
    apart = abs(one.nominal - other.nominal)
    tolerated = max((c.tolerance or 0.0) * abs(c.nominal) for c in (one, other))
    return (one.quantity, one.axis) == (other.quantity, other.axis) and apart <= tolerated


def refused(result: Result, why: str) -> Result:
    """The row of a result that is not believed."""
    return rejected(result.channel, result.measurand, result.title, result.unit, why)


def _judged_by(result: Result, sensor: Sensor) -> Result:
    if result.channel not in sensor or result.value is None:
        return result
    channel = sensor.channel(result.channel)
    if result.measurand.startswith(COUPLING) and abs(result.value) > MOST_COUPLING:
        axis = result.measurand.rpartition("_")[2]
        why = f"found {result.value:.2f} of its own sensitivity, which is no cross-coupling from {axis}"
        return refused(result, f"{why}: channels are swapped, or the cube stands on another axis")
    if result.measurand in SENSITIVITIES and abs(result.value) < FAINT * abs(channel.nominal):
        why = f"found {result.value / channel.nominal:.2g} times the declared sensitivity"
        return refused(result, f"{why}: the motion is not on this channel (swapped, or another axis)")
    found = judged(result, channel.nominal, channel.tolerance)
    if found.measurand == "sensitivity_centripetal" and found.ruling == "fail":
        why = f"found ω²r of {result.value / channel.nominal:.3g} times the declared radius by the data sheet"
        return refused(result, f"{why}: radius or angle on the platter are others")
    return found


def _groups(rows: Iterable[Result], sensor: Sensor) -> Iterator[list[Result]]:
    """What is judged of one measurand along one axis."""
    found: dict[tuple[str, str, str], list[Result]] = {}
    for row in rows:
        if row.verdict is not None and row.value is not None and row.channel in sensor:
            channel = sensor.channel(row.channel)
            found.setdefault((row.measurand, channel.quantity, channel.axis), []).append(row)
    yield from found.values()


def _factors(group: Iterable[Result], sensor: Sensor) -> list[float]:
    return [float(row.value or 0.0) / sensor.channel(row.channel).nominal for row in group]


def _drawn_in(group: list[Result], sensor: Sensor) -> dict[str, str]:
    """Why those that did not fail are doubted where another did and all are off by one factor, by key."""
    failed, factors = [row for row in group if row.verdict == "fail"], _factors(group, sensor)
    units = {sensor.channel(row.channel).triad for row in group}
    mean = sum(factors) / len(factors)
    off = min(abs(one - 1.0) for one in factors)
    if not failed or len(units) < 2 or off < 0.5 * ALIKE or max(factors) - min(factors) > ALIKE * abs(mean):
        return {}
    why = f"{failed[0].channel} fails, and all units are about {mean:.3g} times as declared: the reference may be off"
    return {row.key: why for row in group if row.verdict != "fail"}


def _common(group: list[Result], sensor: Sensor) -> dict[str, str]:
    """Why several units that fail by one factor are not believed, by key; nothing if they do not."""
    failed = [row for row in group if row.verdict == "fail"]
    factors = _factors(failed, sensor)
    units = {sensor.channel(row.channel).triad for row in failed}
    mean = sum(factors) / max(len(factors), 1)
    if len(units) < 2 or max(factors) - min(factors) > ALIKE * abs(mean):
        return {}
    names = ", ".join(row.channel for row in failed)
    why = f"{names} all answer {mean:.3g} times as declared: the reference or the mounting is suspected, not they"
    return {row.key: why for row in failed}
