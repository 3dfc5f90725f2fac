"""The device against its reference, before any model: the same way round, in the unit stated, on the same clock?

Rates are compared as mean rates over short stretches, in which a delay of a few samples does not matter; the device's
factor against the reference is the slope of a straight line. Accelerometers are compared with gravity where they are
still. Of a frequency-response table the lowest frequencies say polarity and unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.foreign.finding import Finding, stretches_of
from rig.foreign.manifest import UNIT_KINDS, Axis, Column
from rig.foreign.tables import Foreign, Table

Array = NDArray[np.float64]
STRETCH = 0.1  # s, over which rates are averaged
CLEAR = 0.6  # correlation from which on the sign is beyond doubt
NEAR = 0.08  # a factor this near to that of a unit is that unit
LEAST_OFF = 0.1  # a factor nearer to one than this is the calibration's business
AXES: tuple[Axis, ...] = ("x", "y", "z")
HALF = 0.83  # of π: a phase at the lowest frequencies beyond it is a polarity


@dataclass(frozen=True)
class Pair:
    """A device's channel and what the reference says it should show: SI, (n,), at `time` (n,)."""

    device: Column
    reference: Column
    time: Array
    shown: Array
    true: Array


def findings(data: Foreign, table: Table) -> Iterator[Finding]:
    """Signs, units and axes of one file."""
    if data.manifest.kind == "response":
        yield from _response(data, table)
        return
    yield from _attitude(data, table)
    for pair in pairs(data, table):
        yield from _sign_and_unit(data, table, pair)
    yield from _clock(data, table)
    yield from _turns(data, table)
    yield from _gravity(data, table)


def pairs(data: Foreign, table: Table) -> list[Pair]:
    """Device channels with what the reference says of them, in stretches of about a tenth of a second."""
    match data.manifest.kind:
        case "rotation":
            return _of_rotation(data, table)
        case "motion":
            return _of_motion(data, table)
        case "sweep":
            return _of_sweep(data, table)
        case _:
            return []


def running(data: Foreign, table: Table) -> tuple[NDArray[np.int64], Array]:
    """Rows whose time stamps are numbers and later than all before, and those stamps, s."""
    stamps = data.time(table)
    finite = np.where(np.isfinite(stamps), stamps, -np.inf)
    before = np.concatenate(([-np.inf], np.maximum.accumulate(finite)[:-1]))
    rows = np.flatnonzero(finite > before)
    return rows, stamps[rows]


def _stretches(time: Array, values: Array, seconds: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Edges of stretches of at least four samples, and means of `values` (n,) between them."""
    step = float(np.median(np.diff(time)))
    size = max(4, round(seconds / step))
    edges = np.arange(0, len(time), size)
    if len(edges) < 8:
        edges = np.arange(0, len(time), max(1, len(time) // 40))
    # trapezoids: the mean of a rate between two instants is the angle between them
    area = np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))))
    return time[edges], np.diff(area[edges]) / np.diff(time[edges]), edges


def _of_rotation(data: Foreign, table: Table) -> list[Pair]:
    rotation = data.manifest.rotation
    angles = data.manifest.of("reference", "angle")
    if rotation is None or not angles:
        return []
    found = []
    for gyro in data.manifest.of("device", "rate"):
        if gyro.axis == rotation.axis:
            found += _angle_pair(data, table, gyro, angles[0], rotation.sense or 1)
    return found


def _angle_pair(data: Foreign, table: Table, gyro: Column, angle: Column, sense: int) -> list[Pair]:
    rows, time = running(data, table)
    shown, true = data.si(table, gyro)[rows], data.si(table, angle)[rows]
    good = np.isfinite(shown) & np.isfinite(true)
    time, shown, true = time[good], shown[good], true[good]
    if len(time) < 32:
        return []
    at, mean, edges = _stretches(time, shown, STRETCH)
    rate = np.diff(np.unwrap(true)[edges]) / np.diff(at)
    return [Pair(gyro, angle, at[:-1], mean, sense * rate)]


def _of_motion(data: Foreign, table: Table) -> list[Pair]:
    rows, time = running(data, table)
    attitude = quaternions(data, table)
    gyros = [one for one in data.manifest.of("device", "rate") if one.axis is not None]
    if attitude is None or not gyros or len(rows) < 32:
        return []
    pose = data.manifest.pose
    track = attitude[rows] * ((1.0, -1.0, -1.0, -1.0) if pose and pose.quaternion == "world_to_body" else 1.0)
    first = data.manifest.of("reference", "quaternion")[0]
    found = []
    for gyro in gyros:
        shown = data.si(table, gyro)[rows]
        at, mean, edges = _stretches(time, shown, STRETCH / 2.0)
        rate = body_rate(track[edges], at)[:, AXES.index(gyro.axis or "x")]
        good = np.isfinite(mean) & np.isfinite(rate)
        found.append(Pair(gyro, first, at[:-1][good], mean[good], rate[good]))
    return found


def quaternions(data: Foreign, table: Table) -> Array | None:
    """Scalar first, (n, 4), normalised; NaN where there are gaps. None without four components."""
    by = {one.component: one for one in data.manifest.of("reference", "quaternion")}
    if not all(part in by for part in ("w", "x", "y", "z")):
        return None
    whole = np.column_stack([data.si(table, by[part]) for part in ("w", "x", "y", "z")])
    size = np.linalg.norm(whole, axis=1, keepdims=True)
    return np.asarray(whole / np.where(size > 0.0, size, np.nan), np.float64)


def body_rate(attitude: Array, time: Array) -> Array:
    """Mean angular rate in the body's frame between attitudes (n, 4), body to world; rad/s, (n − 1, 3).

    The rotation vector of q_k* ⊗ q_{k+1} over the time between (Shuster 1993, eqs. 96 and 175).
    """
    w, v = attitude[:-1, 0], attitude[:-1, 1:]
    w2, v2 = attitude[1:, 0], attitude[1:, 1:]
    scalar = w * w2 + np.sum(v * v2, axis=1)
    vector = w[:, None] * v2 - w2[:, None] * v - np.cross(v, v2)
    vector = np.where(scalar[:, None] < 0.0, -vector, vector)
    size = np.linalg.norm(vector, axis=1)
    angle = 2.0 * np.arctan2(size, np.abs(scalar))
    share = np.divide(angle, size, out=np.full_like(size, 2.0), where=size > 1e-12)
    return np.asarray(vector * (share / np.diff(time))[:, None], np.float64)


def _of_sweep(data: Foreign, table: Table) -> list[Pair]:
    """Device and reference of one file with their means taken off; only what is meant to be the same quantity."""
    found = []
    for reference in data.manifest.of("reference"):
        if reference.quantity not in ("acceleration", "unstated"):
            continue
        for device in data.manifest.of("device"):
            if device.quantity not in ("acceleration", "unstated") or device.axis not in (None, reference.axis):
                continue
            shown, true = data.si(table, device), data.si(table, reference)
            good = np.isfinite(shown) & np.isfinite(true)
            if good.sum() > 32:
                shown, true = shown[good] - shown[good].mean(), true[good] - true[good].mean()
                found.append(Pair(device, reference, data.time(table)[good], shown, true))
    return found


def slope_of(pair: Pair) -> tuple[float, float]:
    """The device's factor against the reference and their correlation; (nan, 0) where nothing moves."""
    if not len(pair.true):
        return math.nan, 0.0
    shown, true = pair.shown - pair.shown.mean(), pair.true - pair.true.mean()
    power, other = float(true @ true), float(shown @ shown)
    if power <= 0.0 or other <= 0.0:
        return math.nan, 0.0
    both = float(shown @ true)
    return both / power, both / math.sqrt(power * other)


def _sign_and_unit(data: Foreign, table: Table, pair: Pair) -> Iterator[Finding]:
    slope, correlation = slope_of(pair)
    if abs(correlation) < CLEAR:
        return
    device, reference = pair.device, pair.reference
    if slope < 0.0:
        text = f"{device.channel} counts against the reference: correlation {correlation:.3f} with {reference.channel}"
        yield Finding("sign", table.label, f"{text}, factor {slope:.4g}", device.channel)
    if device.quantity == "unstated" or reference.quantity == "unstated" or abs(correlation) < 0.9:
        return
    if abs(abs(slope) - 1.0) > max(LEAST_OFF, 1.5 * device.tolerance):
        fits = _explained(data, abs(slope), device, reference)
        text = f"{device.channel} shows {abs(slope):.4g} times what {reference.channel} says it should"
        yield Finding("unit", table.label, f"{text}; {fits}", device.channel)


def _explained(data: Foreign, factor: float, device: Column, reference: Column | None) -> str:
    """Which unit of the device, of the reference or of time would bring a factor to one."""
    fits = _unit_fits(device, factor)
    if reference is not None:
        fits += _unit_fits(reference, 1.0 / factor)
        fits += _time_fits(data, device, reference, factor)
    if fits:
        return "it would fit with " + ", or ".join(fits)
    if abs(factor - 2.0) < 2 * NEAR or abs(factor - 0.5) < NEAR / 2:
        return "a factor of two is a sensitivity setting, or a sampling rate that is not the one stated"
    if device.sensitivity is not None:
        return f"no unit explains it; the sensitivity '{device.sensitivity}' would have to be {factor:.4g} times larger"
    return "no unit explains it; look at the sensitivity setting and the sampling rate"


def _unit_fits(column: Column, factor: float) -> list[str]:
    """Units other than the stated one with which a column's numbers would be `factor` times smaller."""
    kind = UNIT_KINDS[column.quantity]
    if not kind or column.sensitivity is not None or column.unit not in units.KINDS[kind].units:
        return []
    known = units.KINDS[kind].units
    stated = known[column.unit]
    seen: dict[float, str] = {}
    for symbol, unit in known.items():
        ratio = (stated.multiply / stated.divide) / (unit.multiply / unit.divide)
        if symbol == unit.symbol and unit != stated and abs(factor / ratio - 1.0) < NEAR:
            seen.setdefault(ratio, symbol)
    return [f"{column.channel} in {symbol} instead of {column.unit}" for symbol in seen.values()]


def _time_fits(data: Foreign, device: Column, reference: Column, factor: float) -> list[str]:
    """Time stamps in another unit change a rate made of angles, and nothing else."""
    base = data.manifest.time
    if device.quantity != "rate" or reference.quantity == "rate" or base is None or base.column is None:
        return []
    known = {symbol: units.KINDS["time"].units[symbol] for symbol in ("s", "ms", "µs", "ns", "min")}
    stated = units.KINDS["time"].units[base.unit]
    ratios = {s: (stated.multiply / stated.divide) / (u.multiply / u.divide) for s, u in known.items()}
    near = [symbol for symbol, r in ratios.items() if symbol != base.unit and abs(factor / r - 1.0) < NEAR]
    return [f"time in {symbol} instead of {base.unit}" for symbol in near]


def _attitude(data: Foreign, table: Table) -> Iterator[Finding]:
    """Quaternions: of length one, and turning the way that is stated."""
    parts = data.manifest.of("reference", "quaternion")
    if len(parts) != 4:
        return
    size = np.sqrt(np.sum([data.si(table, one) ** 2 for one in parts], axis=0))
    off = np.flatnonzero(np.abs(size - 1.0) > 0.02)
    if len(off):
        text = f"{len(off)} quaternions are not of length one, the first in row {off[0]} ({size[off[0]]:.4g})"
        yield Finding("quaternion", table.label, text, parts[0].channel, stretches_of(off))
    yield from _attitude_sense(data, table)


def _attitude_sense(data: Foreign, table: Table) -> Iterator[Finding]:
    attitude, made = quaternions(data, table), pairs(data, table)
    rows, time = running(data, table)
    if attitude is None or len(made) < 3:
        return
    pose = data.manifest.pose
    stated = pose.quaternion if pose else "body_to_world"
    other = "body_to_world" if stated == "world_to_body" else "world_to_body"
    against = attitude[rows] * ((1.0, -1.0, -1.0, -1.0) if other == "world_to_body" else 1.0)
    here = [slope_of(pair)[1] for pair in made]
    there = []
    for pair in made:
        at, mean, edges = _stretches(time, data.si(table, pair.device)[rows], STRETCH / 2.0)
        rate = body_rate(against[edges], at)[:, AXES.index(pair.device.axis or "x")]
        good = np.isfinite(mean) & np.isfinite(rate)
        there.append(slope_of(Pair(pair.device, pair.reference, at[:-1][good], mean[good], rate[good]))[1])
    if min(there) > 0.9 and min(here) < 0.7:
        text = f"the attitude fits the gyros as '{other}' (correlations {_listed(there)}) and not as '{stated}'"
        yield Finding("quaternion_sense", table.label, f"{text} ({_listed(here)})")


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)


def _clock(data: Foreign, table: Table) -> Iterator[Finding]:
    """A delay between device and reference that grows steadily: their clocks run at different rates."""
    for pair in pairs(data, table):
        if data.manifest.kind == "sweep" or abs(slope_of(pair)[1]) < 0.9 or len(pair.time) < 200:
            continue
        middles, delays, sigmas = _delays(pair)
        if len(middles) < 5:
            continue
        line, covariance = np.polyfit(middles, delays, 1, w=1.0 / sigmas, cov="unscaled")
        left = delays - np.polyval(line, middles)
        scatter = math.sqrt(max(1.0, float(np.sum((left / sigmas) ** 2)) / (len(left) - 2)))
        rate, span = float(line[0]), float(middles[-1] - middles[0])
        sure = abs(rate) > 6.0 * scatter * math.sqrt(float(covariance[0, 0]))
        if sure and abs(rate) * span > max(2e-3, 4.0 * float(np.max(np.abs(left)))):
            grown = f"from {delays[0] * 1e3:.1f} ms to {delays[-1] * 1e3:.1f} ms in {span:.0f} s"
            name = pair.device.channel
            text = f"{name}: its delay against {pair.reference.channel} goes {grown}"
            yield Finding("clock", table.label, f"{text}: the two clocks differ by {rate * 1e6:.0f} ppm", name)


def _delays(pair: Pair, parts: int = 8) -> tuple[Array, Array, Array]:
    """Delay of the device in stretches of the record that move, with its uncertainty, all s; (k,) each.

    By shown(t) ≈ a·true(t) − a·τ·true'(t) + b, fitted in each of `parts` stretches.
    """
    found = []
    slope = np.gradient(pair.true, pair.time)
    for part in np.array_split(np.arange(len(pair.time)), parts):
        if float(np.std(pair.true[part])) < 0.3 * float(np.std(pair.true)):
            continue
        design = np.column_stack([pair.true[part], slope[part], np.ones(len(part))])
        (a, b, c), *_ = np.linalg.lstsq(design, pair.shown[part], rcond=None)
        left = pair.shown[part] - design @ np.array([a, b, c])
        inverse = np.linalg.pinv(design.T @ design)
        sigma = math.sqrt(float(left @ left) / max(len(part) - 3, 1) * float(inverse[1, 1]))
        if a:
            found.append((float(np.mean(pair.time[part])), -float(b / a), max(sigma / abs(float(a)), 1e-9)))
    middles, delays, sigmas = np.array(found, np.float64).reshape(-1, 3).T
    return middles, delays, sigmas


def _turns(data: Foreign, table: Table) -> Iterator[Finding]:
    """Segments of a known turn: the gyro's integral against the angle."""
    stamps = data.time(table)
    for segment in data.manifest.segments:
        for gyro in data.manifest.of("device", "rate"):
            if segment.turn is None or segment.angle is None or gyro.axis != segment.turn:
                continue
            part = slice(segment.first, segment.last)
            time, rate = stamps[part], data.si(table, gyro)[part]
            good = np.isfinite(time) & np.isfinite(rate)
            turned = float(np.trapezoid(rate[good], time[good]))
            factor = turned / segment.angle
            name = f"{segment.label or segment.turn}: {gyro.channel} integrates to {math.degrees(turned):.4g}°"
            wanted = f"for a turn of {math.degrees(segment.angle):.4g}°"
            if abs(factor) > 0.0 and factor < 0.0:
                yield Finding("sign", table.label, f"{name} {wanted}: it counts against it", gyro.channel)
            if abs(abs(factor) - 1.0) > max(2 * LEAST_OFF, 1.5 * gyro.tolerance):
                text = f"{name} {wanted}, {abs(factor):.4g} times as much{_turn_fits(data, gyro, abs(factor))}"
                yield Finding("unit", table.label, text, gyro.channel)


def _turn_fits(data: Foreign, gyro: Column, factor: float) -> str:
    fits = _unit_fits(gyro, factor)
    return f"; it would fit with {', or '.join(fits)}" if fits else "; look at the sensitivity and the sampling rate"


def _gravity(data: Foreign, table: Table) -> Iterator[Finding]:
    """What three accelerometers show while they are still, against gravity."""
    by = {one.axis: one for one in data.manifest.of("device", "acceleration")}
    if data.manifest.kind == "sweep" or not all(axis in by for axis in AXES):
        return
    vector = np.column_stack([data.si(table, by[axis]) for axis in AXES])
    size = still_magnitude(vector[np.isfinite(vector).all(axis=1)])
    ratio = size / data.manifest.gravity.value
    first = by["x"]
    if not math.isfinite(ratio) or abs(ratio - 1.0) <= max(LEAST_OFF, 1.5 * first.tolerance):
        return
    text = f"the accelerometers show {size:.4g} m/s² in all where they are stillest, {ratio:.4g} times gravity"
    fits = _unit_fits(first, ratio)
    said = f"; it would fit with {first.unit} being {' or '.join(f.split(' in ')[1].split(' ')[0] for f in fits)}"
    if not fits:
        said = "; " + _explained(data, ratio, first, None)
    yield Finding("unit", table.label, text + said, first.channel)


def still_magnitude(vector: Array, size: int = 50) -> float:
    """Median length of a vector (n, 3) over its quietest tenth of stretches; NaN if it is too short."""
    count = len(vector) // size
    if count < 1:
        return float(np.median(np.linalg.norm(vector, axis=1))) if len(vector) else math.nan
    blocks = vector[: count * size].reshape(count, size, 3)
    spread = np.sum(np.var(blocks, axis=1), axis=1)
    quiet = np.argsort(spread)[: max(1, count // 10)]
    return float(np.median(np.linalg.norm(np.mean(blocks[quiet], axis=1), axis=1)))


def _response(data: Foreign, table: Table) -> Iterator[Finding]:
    """A response table: frequencies that are none, phases in degrees, polarity and size at the lowest frequencies."""
    frequency = data.si(table, data.manifest.of("reference", "frequency")[0])
    bad = np.flatnonzero(~(frequency > 0.0))
    if len(bad):
        text = f"{len(bad)} frequencies are not positive, the first in row {bad[0]}"
        yield Finding("frequency", table.label, text, stretches=stretches_of(bad))
    response = _complex(data, table)
    good = (frequency > 0.0) & np.isfinite(response)
    if good.sum() < 3:
        return
    yield from _phase_unit(data, table)
    order = np.argsort(frequency[good], kind="stable")
    yield from _low_end(data, table, frequency[good][order], response[good][order])
    yield from _stated(data, table)


def _complex(data: Foreign, table: Table) -> NDArray[np.complex128]:
    by = {one.quantity: data.si(table, one) for one in data.manifest.of("device")}
    if "magnitude" in by and "phase" in by:
        return np.asarray(by["magnitude"] * np.exp(1j * by["phase"]), np.complex128)
    return np.asarray(by["real"] + 1j * by["imaginary"], np.complex128)


def _phase_unit(data: Foreign, table: Table) -> Iterator[Finding]:
    for column in data.manifest.of("device", "phase"):
        numbers = table.of(column.column)
        largest = float(np.max(np.abs(numbers[np.isfinite(numbers)]), initial=0.0))
        if column.unit == "rad" and 20.0 < largest <= 400.0:
            text = f"{column.channel} reaches {largest:.4g}, too much for rad; it would fit with ° instead of rad"
            yield Finding("unit", table.label, text, column.channel)
        elif column.unit in ("°", "deg") and len(numbers) > 8 and largest <= 2.0 * math.pi and np.ptp(numbers) > 1.0:
            text = f"{column.channel} stays within ±{largest:.3g}°, which looks like rad"
            yield Finding("unit", table.label, text, column.channel)


def _low_end(data: Foreign, table: Table, frequency: Array, response: NDArray[np.complex128]) -> Iterator[Finding]:
    lowest = frequency <= frequency[0] * 1.5
    mean = complex(np.mean(response[lowest]))
    angle = math.degrees(math.atan2(mean.imag, mean.real))
    if abs(angle) > 180.0 * HALF:
        text = f"the phase at the lowest frequencies ({frequency[0]:.4g} Hz) is {angle:.2f}°, near 180°"
        yield Finding("polarity", table.label, f"{text}: the device counts against the reference (polarity)")
    size, column = abs(mean), data.manifest.of("device")[0]
    known = {"9.80665 (g and m/s²)": units.STANDARD_GRAVITY, "1000": 1e3, "57.3 (° and rad)": 180.0 / math.pi,
             "2π (Hz and rad/s)": 2.0 * math.pi}  # fmt: skip
    near = [name for name, k in known.items() for f in (k, 1.0 / k) if abs(size / f - 1.0) < NEAR]
    if near and not column.unit and abs(size - 1.0) > 1.5 * column.tolerance:
        text = f"{column.channel} is {size:.4g} at the lowest frequencies, a factor of {near[0]} away from one"
        yield Finding("unit", table.label, f"{text}: device and reference may be in different units", column.channel)


def _stated(data: Foreign, table: Table) -> Iterator[Finding]:
    for column in data.manifest.columns:
        u = data.u(table, column)
        if u is not None and np.any(~(u > 0.0)):
            rows = np.flatnonzero(~(u > 0.0))
            text = f"{column.channel}: {len(rows)} uncertainties are not positive, the first in row {rows[0]}"
            yield Finding("uncertainty", table.label, text, column.channel, stretches_of(rows))
