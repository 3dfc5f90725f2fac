"""Tones and clocks of imported sweeps: the frequency that was commanded, the one that came out, and the mains.

A recorder whose clock is off moves every line by the same share; a drive that is off moves its own line and leaves the
mains where they are. So the mains lines, where a manifest states their frequency, say which of the two it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.errors import BadInput
from rig.foreign.finding import Finding
from rig.foreign.manifest import Column
from rig.foreign.pairs import running
from rig.foreign.tables import Foreign, Table
from rig.signals.tone import fit_four

Array = NDArray[np.float64]
Mains = tuple[float, list[float]]  # how much higher its lines come out, and the lines, Hz
OFF = 2e-3  # relative, from which a commanded frequency was not kept
DOMINANT = 0.2  # share of a record's power in its strongest line, to be the tone that was commanded
STANDS_OUT = 10.0  # power of a mains line over the median around it
WIDEST = 0.08  # how far a recorder's clock is looked for, relative
MULTIPLES = 10  # of the mains


@dataclass(frozen=True)
class Line:
    """A dominant line of one channel in one file."""

    label: str
    channel: str
    commanded: float | None
    frequency: float


def findings(data: Foreign, table: Table) -> Iterator[Finding]:
    """Device and reference of one file with their line at different frequencies."""
    if data.manifest.kind != "sweep":
        return
    rows, time = even(data, table)
    if not len(time):
        return
    references = [(one, strongest(time, data.si(table, one)[rows])) for one in data.manifest.of("reference")]
    for device in data.manifest.of("device"):
        here = strongest(time, data.si(table, device)[rows])
        for reference, there in references:
            if here is None or there is None or not 0.5 < here / there < 2.0:
                continue
            if abs(here - there) > max(2e-4 * there, 0.02 / float(time[-1] - time[0])):
                text = f"{device.channel} has its line at {here:.5g} Hz and {reference.channel} at {there:.5g} Hz"
                yield Finding("clock", table.label, f"{text}: their clocks differ by {(here / there - 1) * 1e2:+.3g} %")


def across(data: Foreign) -> list[Finding]:
    """What all files of a sweep say together: commanded against found frequency, level, and the mains."""
    if data.manifest.kind != "sweep":
        return []
    lines = [line for table in data.tables if (line := _commanded(data, table)) is not None]
    off = [line for line in lines if line.commanded and abs(line.frequency / line.commanded - 1.0) > OFF]
    mains = clock_of(data) if data.manifest.mains else None
    found = [*_off(data, off, lines, mains), *_drive(data)]
    if mains is not None and not off:
        found += _recorder(data, mains)
    return found


def even(data: Foreign, table: Table) -> tuple[NDArray[np.int64], Array]:
    """Rows and instants that a line can be fitted to; none if time does not run."""
    rows, time = running(data, table)
    if len(time) < 64:
        return rows[:0], time[:0]
    return rows, time


def strongest(time: Array, values: Array) -> float | None:
    """Frequency of a record's strongest line, Hz; None if no line holds a fair share of its power."""
    good = np.isfinite(values)
    time, values = time[good], values[good]
    if len(values) < 64 or float(np.ptp(values)) == 0.0:
        return None
    rate = (len(time) - 1) / float(time[-1] - time[0])
    values = values - values.mean()
    power = np.abs(np.fft.rfft(values * np.hanning(len(values)), 4 * len(values))) ** 2
    power[:6] = 0.0
    start = float(np.argmax(power)) * rate / (4 * len(values))
    try:
        tone = fit_four(time, values, start)
    except BadInput:
        return None
    share = 0.5 * abs(tone.amplitudes[0]) ** 2 / float(np.mean(values**2))
    return tone.frequency if share > DOMINANT else None


def _commanded(data: Foreign, table: Table) -> Line | None:
    """The line of a file that says what it was driven with: of its drive, else of its reference."""
    wanted = frequency_setting(table)
    rows, time = even(data, table)
    if wanted is None or not len(time):
        return None
    for column in [*data.manifest.of("drive"), *data.manifest.of("reference"), *data.manifest.of("device")]:
        found = strongest(time, data.si(table, column)[rows])
        if found is not None:
            return Line(table.label, column.channel, wanted, found)
    return None


def frequency_setting(table: Table) -> float | None:
    """What was commanded, Hz; None if the file does not say."""
    stated = table.settings.get("frequency")
    try:
        return units.parse(stated, "frequency")
    except units.UnitError:
        return None


def _off(data: Foreign, off: Sequence[Line], lines: Sequence[Line], mains: Mains | None) -> Iterator[Finding]:
    """One sentence for every frequency that was commanded and not kept."""
    for commanded in sorted({line.commanded for line in off if line.commanded}):
        here = [line.frequency for line in off if line.commanded == commanded]
        count = sum(line.commanded == commanded for line in lines)
        ratio = float(np.median(here)) / commanded
        text = (
            f"commanded {commanded:.5g} Hz, found {float(np.median(here)):.4g} Hz ({(ratio - 1) * 1e2:+.2g} %) by the "
            f"recorder's clock, in {len(here)} of {count} files"
        )
        where = "all files" if len(here) > 1 else off[0].label
        yield Finding("frequency", where, f"{text}; {_blame(data, ratio, mains)}")


def _blame(data: Foreign, ratio: float, mains: Mains | None) -> str:
    for factor, said in ((1e3, "ms and s"), (1e-3, "ms and s"), (2.0, ""), (0.5, ""), (2 * math.pi, "Hz and rad/s")):
        if abs(ratio / factor - 1.0) < 0.05:
            return f"a factor of {factor:.4g}: look at the time base" + (f" ({said} mixed up)" if said else "")
    if mains is None:
        why = "no mains line stands out" if data.manifest.mains else "`mains: 50 Hz` or `60 Hz` in the manifest would"
        return f"nothing here tells whether the drive or the recorder is off ({why})"
    scale, where = mains[0], _come_out(data, mains)
    if abs(scale - 1.0) < 0.2 * abs(ratio - 1.0):
        return f"{where}: so the drive is off, not the recorder"
    if abs(scale - ratio) < 0.2 * abs(ratio - 1.0):
        return f"{where}, by the same share: so the recorder's clock is off, not the drive"
    return f"{where}: drive and recorder are both off"


def _recorder(data: Foreign, mains: Mains) -> Iterator[Finding]:
    if abs(mains[0] - 1.0) > 5e-3:
        yield Finding("clock", "all files", f"{_come_out(data, mains)}: the recorder's clock is off")


def _come_out(data: Foreign, mains: Mains) -> str:
    scale, found = mains
    listed = ", ".join(f"{one:.1f}" for one in found)
    share = f"{(scale - 1) * 1e2:+.2f} % from multiples of {data.manifest.mains:g} Hz"
    return f"the mains lines come out at {listed} Hz, {share}"


def _drive(data: Foreign) -> Iterator[Finding]:
    """A numeric setting `drive` that the measured drive does not follow from file to file."""
    columns = data.manifest.of("drive")
    if not columns:
        return
    stated: list[tuple[str, float, float]] = []
    for table in data.tables:
        drive = table.settings.get("drive")
        if isinstance(drive, float | int) and drive > 0.0:
            shown = data.si(table, columns[0])
            known = shown[np.isfinite(shown)]
            stated.append((table.label, float(drive), float(known.std()) if len(known) else 0.0))
    if len(stated) < 4:
        return
    usual = float(np.median([level / drive for _, drive, level in stated]))
    for label, drive, level in stated:
        if usual > 0.0 and abs(level / drive / usual - 1.0) > 0.03:
            off = f"{(level / drive / usual - 1) * 1e2:+.1f} % off what its setting {drive:g} gives in the other files"
            text = f"{columns[0].channel} is {off}, as if that were {level / usual:.3g}"
            yield Finding("drive", label, text)


def clock_of(data: Foreign) -> Mains | None:
    """How much higher mains lines come out than they are, and the lines, Hz; None if they do not stand out.

    All lines are looked for at once, at multiples of one frequency (a comb), in the records that nothing drove, else
    in all of them beside the lines of the drive.
    """
    mains = data.manifest.mains
    assert mains is not None
    tables = [one for one in data.tables if frequency_setting(one) is None] or list(data.tables)
    spectra = [s for table in tables for c in _recorded(data) if (s := _spectrum(data, table, c)) is not None]
    if not spectra:
        return None
    # lines are told apart to a fraction of the resolution at the highest of them
    fine = min(frequency[1] for frequency, _ in spectra) / (4.0 * MULTIPLES * mains)
    scales = 1.0 + np.arange(-round(WIDEST / fine), round(WIDEST / fine) + 1) * fine
    score, each = np.zeros(len(scales)), np.zeros((MULTIPLES, len(scales)))
    for frequency, power in spectra:
        for k in range(1, MULTIPLES + 1):
            at = np.interp(k * mains * scales, frequency, power, right=0.0)
            each[k - 1] += at / len(spectra)
            score += np.log1p(at)
    best = int(np.argmax(score))
    strong = [k for k in range(1, MULTIPLES + 1) if each[k - 1, best] > STANDS_OUT]
    if len(strong) < 2 and not (strong and MULTIPLES * mains > spectra[0][0][-1]):
        return None
    return float(scales[best]), [k * mains * float(scales[best]) for k in strong]


def _recorded(data: Foreign) -> list[Column]:
    return [*data.manifest.of("reference"), *data.manifest.of("device")]


def _spectrum(data: Foreign, table: Table, column: Column) -> tuple[Array, Array] | None:
    """Power over its running median, lines of the drive taken out; frequency (m,), ratio (m,)."""
    from scipy.ndimage import median_filter

    rows, time = even(data, table)
    values = data.si(table, column)[rows]
    if len(time) < 512 or not np.isfinite(values).all() or float(np.ptp(values)) == 0.0:
        return None
    rate = (len(time) - 1) / float(time[-1] - time[0])
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))) ** 2
    frequency = np.arange(len(power)) * rate / len(values)
    around = median_filter(power, size=min(101, len(power)))
    ratio = np.asarray(power / np.maximum(around, np.finfo(float).tiny), np.float64)
    tone = strongest(time, values) if frequency_setting(table) is not None else None
    if tone is not None:
        nearest = np.abs(frequency - np.rint(frequency / tone) * tone)
        ratio[nearest < 3.0 * frequency[1]] = 1.0
    return frequency, ratio
