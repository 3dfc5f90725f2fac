"""Imported sweeps: sines on a shaker that another accelerometer on the same recorder has seen, as `SweepRecords`.

What both accelerometers show between the lines is mostly real: a shaker rattles. Noise is therefore only what the
device shows and the reference does not,  ε = device − H·reference  with H where it is known best: from the lines
between the harmonics where they are coherent, else from the driven line. The noise of the reference is in ε too; with
two devices or more the part that their ε share is the reference's, with one it cannot be told apart and counts as the
device's.

Files of different days have no common phase of the mains: mains lines are separated and reported, and not compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.errors import BadInput
from rig.foreign.faults import faults, lined
from rig.foreign.manifest import Column, Manifest
from rig.foreign.tables import CONDITIONS, Foreign, Table
from rig.model import Channels
from rig.motion import ORDERS
from rig.parts.reading.imported_notes import notes
from rig.parts.reading.shaker_distortion import shaker_remarks
from rig.parts.sweep_lines import Separated, density, filled, mains_seen, separated, taken
from rig.parts.sweep_records import LINES, Leftover, SweepRecords, directions
from rig.signals import tone
from rig.signals.noise import NoiseModel
from rig.signals.record_means import Means, noise_of

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
REST = "rest"
SEARCHED = (0.7, 1.4)  # of the commanded frequency: where the driven line is looked for
PEAK = 10.0  # amplitude of the driven line over the median line in that band
SHORTEST = 5.0  # cycles
MOST_FAULTY = 0.3  # of the rows of a record: with more left out the rest says little
EVEN = 0.1  # of the interval: how far a time stamp may lie from even spacing
COHERENT = 0.9  # coherence² above which the lines between give the ratio of device and reference
SHARE, LINES_BESIDE = 0.3, 12  # neighbourhood of a line, as in `tone.line_variances`
OF_DEVICE = ("acceleration", "rate", "unstated", "voltage")
OF_REFERENCE = ("acceleration", "unstated", "voltage")


@dataclass(frozen=True)
class _Record:
    """One file: instants from its own beginning (n,), rows of reference (first) and devices, SI, (n, 1 + c)."""

    table: Table
    t: Array
    values: Array
    rate: float
    begin: float
    nominal: float  # 0 at rest
    frequency: float
    delay: Array  # (1 + c,)
    harmonics: Complexes  # 1 … k of the drive at common instants, (1 + c, k)
    lines: Separated
    leftover: Leftover
    lost: Array  # share of the rows that are no measurement, (1 + c,)

    @property
    def seconds(self) -> float:
        return len(self.t) / self.rate


def sweeps(foreign: Foreign) -> list[SweepRecords]:
    """The files of a run of kind "sweep", as one mounting; [] for another kind.

    Raises BadInput for files without even time stamps, with gaps, or without a line near the commanded frequency.
    """
    if foreign.manifest.kind != "sweep":
        return []
    columns = _columns(foreign)
    records: list[_Record] = []
    for table in foreign.tables:
        records.append(_record(foreign, table, columns, records[-1] if records else None))
    if not any(one.nominal for one in records):
        raise BadInput(f"{foreign.run}: found no file with a frequency in its settings, wanted one such as '5 Hz'")
    made = _joined(foreign, columns, records)
    said = (*notes(columns, made), *shaker_remarks(foreign, made))
    held = np.array([table.held_out for table in foreign.tables])
    return [replace(made, notes=said, held=held if held.any() else None, vibrometer=False)]


def _columns(foreign: Foreign) -> list[Column]:
    """Reference and devices."""
    made = foreign.manifest
    reference = [one for one in made.of("reference") if one.quantity in OF_REFERENCE]
    device = [one for one in made.of("device") if one.quantity in OF_DEVICE]
    if len(reference) != 1 or not device:
        wanted = "wanted one reference and at least one device, of acceleration or unstated"
        raise BadInput(f"{foreign.run}: found {len(reference)} references and {len(device)} devices, {wanted}")
    return [reference[0], *device]


def _record(foreign: Foreign, table: Table, columns: Sequence[Column], before: _Record | None) -> _Record:
    where = f"{foreign.run} {table.label}"
    stamps = foreign.time(table)
    values, faulty = _whole(foreign, table, columns)
    bad = int(np.count_nonzero(~np.isfinite(np.column_stack([stamps, values])).all(axis=1)))
    if bad:
        raise BadInput(f"{where}: found {bad} rows that are no numbers, wanted a record without gaps")
    interval = _interval(where, stamps)
    t = stamps - stamps[0]
    begin = _begin(float(stamps[0]), before)
    nominal = _nominal(where, table)
    for one, column in zip(columns, values.T, strict=True):
        if nominal and not np.ptp(column) > 0.0:
            raise BadInput(f"{where}, {one.channel}: found nothing but {column[0]:g}, wanted a sine of {nominal:g} Hz")
    frequency = _found(foreign, table, where, t, values, nominal)
    delay = np.array([one.delay for one in columns])
    values = filled(t, values, faulty, 1.0 / interval, frequency) if faulty.any() and frequency else values
    lines = _taken_apart(t, values, 1.0 / interval, begin, frequency, foreign.manifest.mains)
    leftover = _leftover(lines.left + lines.hum, 1.0 / interval, begin, frequency or None, delay)
    at = np.asarray(frequency * np.arange(1, lines.harmonics.shape[1] + 1), np.float64)
    harmonics = _turned(lines.harmonics.T, at, delay).T
    return _Record(table, t, values, 1.0 / interval, begin, nominal, frequency, delay, harmonics, lines, leftover,
                   faulty.mean(axis=0))  # fmt: skip


def _whole(foreign: Foreign, table: Table, columns: Sequence[Column]) -> tuple[Array, NDArray[np.bool_]]:
    """Columns in SI with a straight line where samples are no measurement, and where that is, both (n, c).

    Raises BadInput if too few are left.
    """
    values, faulty = [], []
    for one in columns:
        column, flags = foreign.si(table, one), np.zeros(len(table.values), np.bool_)
        for fault in faults(foreign, table, one):
            flags[fault.rows] = True
        if (share := float(flags.mean())) > MOST_FAULTY:
            where = f"{foreign.run} {table.label}, {one.channel}"
            wanted = f"wanted {MOST_FAULTY:.0%} at most"
            raise BadInput(f"{where}: found {share:.0%} of the rows that are no measurement, {wanted}")
        values.append(lined(column, np.flatnonzero(flags)) if flags.any() else column)
        faulty.append(flags)
    return np.stack(values, axis=1), np.stack(faulty, axis=1)


def _interval(where: str, stamps: Array) -> float:
    """Interval of even time stamps, s."""
    interval = float(stamps[-1] - stamps[0]) / max(len(stamps) - 1, 1)
    even = stamps[0] + interval * np.arange(len(stamps))
    worst = float(np.abs(stamps - even).max())
    if not interval > 0.0 or worst > EVEN * interval:
        wanted = f"wanted them within {EVEN:g} of an interval of even spacing"
        raise BadInput(f"{where}: found time stamps up to {worst:.3g} s away from every {interval:.3g} s, {wanted}")
    return interval


def _begin(stamp: float, before: _Record | None) -> float:
    """When a record began, s: its own stamp, or after the one before where every file counts from its own zero."""
    if before is None:
        return stamp
    return max(stamp, before.begin + before.seconds)


def _nominal(where: str, table: Table) -> float:
    """Commanded frequency, Hz; 0 at rest."""
    commanded = table.settings.get("frequency")
    if table.settings.get("level") == REST or commanded is None:
        return 0.0
    try:
        found = float(commanded) if isinstance(commanded, float) else units.parse(commanded, "frequency")
    except units.UnitError as error:
        raise BadInput(f"{where} settings.frequency: {error}") from None
    if not found > 0.0:
        raise BadInput(f"{where} settings.frequency: found {found:g} Hz, wanted one above zero")
    return found


def _found(foreign: Foreign, table: Table, where: str, t: Array, values: Array, nominal: float) -> float:
    """The driven frequency by the recorder's clock, Hz: from the measured drive if there is one, else the reference."""
    if not nominal:
        return 0.0
    if (cycles := float(t[-1]) * nominal) < SHORTEST:
        raise BadInput(f"{where}: found a record of {cycles:.2g} cycles, wanted at least {SHORTEST:g}")
    drive = foreign.manifest.of("drive")
    signal = foreign.si(table, drive[0]) if drive else values[:, 0]
    if not np.isfinite(signal).all():
        raise BadInput(f"{where}: found rows of the drive that are no numbers, wanted a record without gaps")
    rate = (len(t) - 1) / float(t[-1])
    padded = 4 * len(t)  # lines a quarter of the resolution apart: the peak is a start within half a cycle
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(t)), padded))
    f = np.fft.rfftfreq(padded, 1.0 / rate)
    near = np.flatnonzero((f > SEARCHED[0] * nominal) & (f < SEARCHED[1] * nominal))
    if not len(near):
        raise BadInput(f"{where}: found {nominal:g} Hz at {rate:g} samples per second, wanted less than half of that")
    peak = int(near[np.argmax(spectrum[near])])
    if spectrum[peak] < PEAK * np.median(spectrum[near]):
        raise BadInput(f"{where}: found no line near {nominal:g} Hz, wanted the commanded one, or level: rest")
    harmonics = max(1, min(ORDERS - 1, math.floor(0.49 * rate / f[peak])))
    return tone.fit_four(t, signal, float(f[peak]), harmonics).frequency


def _taken_apart(
    t: Array, values: Array, rate: float, begin: float, frequency: float, mains: float | None
) -> Separated:
    """Harmonics first; then with the mains lines where that leftover shows them."""
    driven = frequency or None
    first = separated(t, values, rate, driven, None)
    if mains is None:
        return first
    seen = mains_seen([_leftover(first.left, rate, begin, driven, np.zeros(values.shape[1]))], mains)
    return separated(t, values, rate, driven, seen.frequency if seen else mains)


def _leftover(left: Array, rate: float, begin: float, frequency: float | None, delay: Array) -> Leftover:
    """Spectrum of the leftover, of all devices and the reference."""
    resolution = rate / len(left)
    spectrum = np.asarray(np.fft.rfft(left, axis=0) * (2.0 / len(left)))
    at = np.asarray(np.arange(len(spectrum)) * resolution, np.float64)
    spectrum = _turned(spectrum, at, delay)
    every = 1 if frequency is None else math.ceil(0.5 * rate / frequency)
    marked = taken(at, frequency, resolution, every)
    return Leftover(begin, resolution, spectrum[:, 1:], spectrum[:, 0], marked)


def _turned(spectrum: Complexes, f: Array, delay: Array) -> Complexes:
    """Spectra (…, f, c) at common instants: what is sampled `delay` s (c,) after its row's stamp shows a phase of
    2π·f·delay too much."""
    return np.asarray(spectrum * np.exp(-2j * math.pi * f[:, None] * delay))


def _joined(foreign: Foreign, columns: Sequence[Column], records: Sequence[_Record]) -> SweepRecords:
    made, device = foreign.manifest, columns[1:]
    count = len(records)
    own, shared = _noise(records)
    axis = device[0].axis or "x"
    observed = np.stack([_observed(one) for one in records], axis=1)
    shown = np.stack([_harmonics(one)[0] for one in records])
    conditions = {name: np.array([_mean(foreign.condition(one.table, name)) for one in records]) for name in CONDITIONS}
    beside = np.stack([*conditions.values(), [one.begin for one in records]])
    return SweepRecords(
        name=f"{foreign.run}#0",
        run=foreign.run,
        axis=axis,
        channels=_channels(device, columns[0].delay, axis),
        observed=observed,
        before=np.zeros_like(observed),
        variance=own,
        noise=tuple(_of_means(records, c, one.bandwidth, made.mains, beside) for c, one in enumerate(device)),
        shown=shown,
        gated=shown,
        outliers=np.zeros((count, 2)),
        reference_variance=shared,
        frequency=np.array([one.frequency for one in records]),
        nominal=np.array([one.nominal for one in records]),
        begin=np.array([one.begin for one in records]),
        end=np.array([one.begin + one.seconds for one in records]),
        level=tuple(_level(made, one.table) if one.nominal else REST for one in records),
        index=np.array([p if one.nominal else -1 for p, one in enumerate(records)]),
        usable=np.ones((len(device), count), np.bool_),
        source=np.zeros(count),
        scale=np.array([1.0 if one.nominal else 0.0 for one in records]),
        temperature=conditions["temperature"],
        supply=conditions["supply"],
        mains=made.mains or math.nan,
        gravity=made.gravity.value,
        directions=directions(axis),
        leftovers=tuple(one.leftover for one in records),
    )


def _channels(device: Sequence[Column], reference_delay: float, axis: str) -> Channels:
    """Numbers are SI already: sensitivities are one. Slots are the places in a scan, if delays say there is one."""
    delay = np.array([one.delay for one in device]) - reference_delay
    steps = np.abs(delay[delay != 0.0])
    return Channels(
        names=tuple(one.channel for one in device),
        rates=np.array([one.quantity == "rate" for one in device]),
        axis=np.array(["xyz".index(one.axis or axis) for one in device]),
        slot=np.round(delay / steps.min()).astype(np.intp) if len(steps) else np.zeros(len(device), np.intp),
        side=np.full(len(device), math.nan),
        sensitivity=np.ones(len(device)),
        tolerance=np.array([one.tolerance for one in device]),
        pole=np.array([one.bandwidth or math.inf for one in device]),
        unit=("unit",) * len(device),
    )


def _level(made: Manifest, table: Table) -> str:
    """What a level is called: its name, or its settings, or the file's label."""
    if "level" in table.settings:
        return str(table.settings["level"])
    said = [
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in table.settings.items()
        if name != "frequency"
    ]
    return ", ".join(said) or table.label


def _mean(values: Array) -> float:
    """Of what is a number, NaN of nothing."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def _harmonics(one: _Record) -> Complexes:
    """Harmonics 0 … 5 of reference and devices, (1 + c, 6); none of the drive at rest, zero above half the rate."""
    found = np.zeros((one.values.shape[1], ORDERS), np.complex128)
    first = one.harmonics[:, : ORDERS - 1]
    found[:, 1 : 1 + first.shape[1]] = first
    return found


def _observed(one: _Record) -> Complexes:
    """Mean and harmonics of the devices, (c, LINES); NaN where there is no line, and for the mains."""
    found = np.full((one.values.shape[1] - 1, LINES), np.nan, np.complex128)
    found[:, 0] = one.lines.mean[1:]
    count = min(one.harmonics.shape[1], ORDERS - 1)
    found[:, 1 : 1 + count] = one.harmonics[1:, :count]
    return found


def _ratio(one: _Record, records: Sequence[_Record]) -> Complexes:
    """Device over reference at the driven line, (c,); at rest the median of the driven records."""
    ratios = np.array([r.harmonics[1:, 0] / r.harmonics[0, 0] for r in records if r.nominal])
    if one.nominal:
        return np.asarray(one.harmonics[1:, 0] / one.harmonics[0, 0])
    return np.asarray(np.median(ratios.real, axis=0) + 1j * np.median(ratios.imag, axis=0))


def _of_means(
    records: Sequence[_Record], row: int, pole: float | None, mains: float | None, beside: Array
) -> NoiseModel:
    """Noise of a device's means: of its spectra as they stand and without what the reference shows, the lesser.

    The reference takes motion away and brings its own noise in. Hum is in no mean.
    """
    bare = [_leftover(one.lines.left, one.rate, one.begin, one.frequency or None, one.delay) for one in records]
    without = [
        replace(left, amplitude=left.amplitude - left.reference[:, None] * _ratio(one, records))
        for left, one in zip(bare, records, strict=True)
    ]
    begin = np.array([one.begin for one in records])
    means = Means(
        np.array([float(one.lines.mean[1 + row]) for one in records]), begin,
        begin + np.array([one.seconds for one in records]),
        np.array([float(np.sum(np.abs(one.harmonics[0]) ** 2)) if one.nominal else 0.0 for one in records]), beside,
    )  # fmt: skip
    spectra = [density(left, row, mains) for left in (bare, without)]
    return noise_of(spectra, records[0].rate, pole, means)


def _noise(records: Sequence[_Record]) -> tuple[Array, Array]:
    """Variance of each part of every line: of the devices (c, p, LINES), and of the reference (p, 6)."""
    devices = records[0].values.shape[1] - 1
    own, shared = np.full((devices, len(records), LINES), np.nan), np.full((len(records), ORDERS), np.nan)
    for p, one in enumerate(records):
        if not one.nominal:
            continue
        spectra, free = _cleaned(one)
        ratio = _ratio(one, records)
        for k in range(1, min(one.harmonics.shape[1], ORDERS - 1) + 1):
            near = _near(one, free, k)
            left = _left_between(spectra[near], ratio)
            power = 0.5 * np.mean(np.abs(left) ** 2, axis=0)
            shared[p, k] = _common(left, ratio)
            own[:, p, k] = np.maximum(power - shared[p, k] * np.abs(ratio) ** 2, 0.1 * power)
        # rows that were filled in have no noise of their own, and say nothing of a line
        own[:, p] /= (1.0 - one.lost[1:, None]) ** 2
        shared[p] /= (1.0 - one.lost[0]) * (1.0 - float(one.lost.max()))
    return own, shared


def _cleaned(one: _Record) -> tuple[Complexes, NDArray[np.bool_]]:
    """Spectra of reference and devices without hum, (f, 1 + c), and the lines that were not emptied by the fit."""
    count = len(one.t)
    spectra = np.asarray(np.fft.rfft(one.lines.left, axis=0) * (2.0 / count))
    resolution = one.rate / count
    at = np.asarray(np.arange(len(spectra)) * resolution, np.float64)
    spectra = _turned(spectra, at, one.delay)
    free = ~one.leftover.taken
    for line in one.lines.mains:
        free &= np.abs(at - line) > 1.5 * resolution
    return spectra, free


def _near(one: _Record, free: NDArray[np.bool_], order: int) -> NDArray[np.intp]:
    """Free lines around a harmonic that say what noise it has."""
    centre = order * one.frequency * len(one.t) / one.rate
    reach = max(SHARE * centre, LINES_BESIDE + 2.0)
    while True:
        low, high = max(1, math.ceil(centre - reach)), min(len(free) - 2, math.floor(centre + reach))
        found = low + np.flatnonzero(free[low : high + 1])
        if len(found) >= LINES_BESIDE or (low == 1 and high == len(free) - 2):
            return found if len(found) else np.arange(1, len(free) - 1)
        reach *= 1.5


def _left_between(spectra: Complexes, ratio: Complexes) -> Complexes:
    """ε of some lines, (k, c): with H from the lines themselves where they are coherent, else from the driven line."""
    reference, device = spectra[:, 0], spectra[:, 1:]
    power = float(np.sum(np.abs(reference) ** 2))
    cross = np.conj(reference) @ device
    coherence = np.abs(cross) ** 2 / np.maximum(power * np.sum(np.abs(device) ** 2, axis=0), 1e-300)
    own = cross / max(power, 1e-300)
    # one complex number was taken from so many lines
    lost = math.sqrt(len(reference) / max(len(reference) - 1, 1))
    best = np.where(coherence > COHERENT, own, ratio)
    return np.asarray((device - reference[:, None] * best) * np.where(coherence > COHERENT, lost, 1.0))


def _common(left: Complexes, ratio: Complexes) -> float:
    """Variance of each part of the reference's noise, from what the ε of two devices or more share."""
    referred = left / ratio
    c = referred.shape[1]
    if c < 2:
        return 0.0
    product = (np.conj(referred).T @ referred).real / (2.0 * len(left))
    return float(np.clip(product[np.triu_indices(c, 1)].mean(), 0.0, np.diag(product).min()))
