"""What the rows of a sweep stand for: lines by harmonic, conditions of the records, noise, orders to look along."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rig.motion import ORDERS, Array, Complexes
from rig.parts.remainder import Cut, Mask, Remainder, Series
from rig.parts.sweep_records import WIDTH, SweepRecords, domains, split


def domains_of(data: SweepRecords) -> dict[str, Mask]:
    """Rows of the mean and of every line, (width,)."""
    of = np.tile(np.arange(WIDTH), len(data.frequency))
    return {
        domain: (of == 0) if place == 0 else (of == 2 * place - 1) | (of == 2 * place)
        for place, domain in enumerate(domains())
    }


def components(data: SweepRecords) -> dict[str, Mask]:
    """The same with the driven line as magnitude and phase: it is turned by its prediction."""
    of = np.tile(np.arange(WIDTH), len(data.frequency))
    found: dict[str, Mask] = {}
    for domain, mask in domains_of(data).items():
        found |= {"magnitude": of == 1, "phase": of == 2} if domain == "1f" else {domain: mask}
    return found


def turned(data: SweepRecords, rest: Remainder) -> Complexes:
    """Lines in standard deviations, the driven one turned by its prediction, (c, p, LINES − 1).

    Its real part is then an error of magnitude and its imaginary part one of phase.
    """
    c, p = data.usable.shape
    _, lines = split(rest.left, c, p)
    wanted = rest.predicted[..., 1]
    phase = np.exp(-1j * np.angle(np.where(np.isfinite(wanted), wanted, 1.0)))
    lines = lines.copy()
    lines[..., 0] *= phase
    return lines


def squares(data: SweepRecords, rest: Remainder) -> Array:
    """Squares of means and turned lines, (c, width)."""
    c, p = data.usable.shape
    means, _ = split(rest.left, c, p)
    lines = turned(data, rest)
    pairs = np.stack([lines.real, lines.imag], axis=-1).reshape(c, p, -1)
    return np.asarray(np.concatenate([means[..., None], pairs], axis=-1).reshape(c, -1) ** 2)


def cuts(data: SweepRecords) -> Iterator[Cut]:
    """By frequency, level, time, temperature, supply, and the vibrometer's range."""
    for words, mask in terciles(data.frequency, data.driven):
        yield Cut("frequency", f"{words} Hz", np.repeat(mask, WIDTH))
    for level in dict.fromkeys(data.level):
        mask = np.array([one == level for one in data.level])
        yield Cut("level", "at rest" if level == "rest" else f"{level} level", np.repeat(mask, WIDTH))
    every = np.ones(len(data.driven), np.bool_)
    for kind, values, thirds in (
        ("time", data.begin, ("early", "half-way", "late")),
        ("temperature", data.temperature, ("while cool", "at middling temperature", "while warm")),
        ("supply", data.supply, ("at low supply", "at middling supply", "at high supply")),
    ):
        if np.isfinite(values).all() and np.ptp(values) > 0.0:
            for words, (_, mask) in zip(thirds, terciles(values, every), strict=False):
                yield Cut(kind, words, np.repeat(mask, WIDTH))
    scales = sorted(set(data.scale[data.driven].tolist()))
    for scale in scales if len(scales) > 1 else []:
        yield Cut("range", f"vibrometer at {scale:g} (m/s)/V", np.repeat(data.driven & (data.scale == scale), WIDTH))


def joined(data: SweepRecords, some: Sequence[Cut]) -> str:
    """Several spans of frequency as one."""
    f = np.repeat(data.frequency, WIDTH)
    inside = np.concatenate([f[cut.mask] for cut in some])
    return f"{span(float(inside.min()), float(inside.max()))} Hz"


def terciles(values: Array, here: Mask) -> list[tuple[str, Mask]]:
    """Three thirds of the values that are `here`, each with its bounds; equal values stay together."""
    different = np.unique(values[here])
    found = []
    for some in np.array_split(different, 3):
        if len(some):
            found.append((span(float(some[0]), float(some[-1])), here & (values >= some[0]) & (values <= some[-1])))
    return found


def span(low: float, high: float) -> str:
    """Bounds as a person says them, `20–57`."""
    first, last = f"{low:.3g}", f"{high:.3g}"
    return first if first == last else f"{first}–{last}"


def noise(data: SweepRecords) -> Array:
    """Variance of every row, referred to the input by the data sheet, SI², (c, p, WIDTH); of a line each part's.

    The sensor's noise, and the reference's in channels along the drive.
    """
    sensitivity = data.channels.sensitivity
    variance = data.variance / sensitivity[:, None, None] ** 2
    along = data.directions[data.channels.axis, 0] * ~data.channels.rates
    variance[..., :ORDERS] += np.multiply.outer(along**2, np.nan_to_num(data.reference_variance))
    since = float(data.begin.min())
    for row, model in enumerate(data.noise):
        own = np.diag(model.covariance(data.begin - since, data.end - since))
        variance[row, :, 0] = own / sensitivity[row] ** 2
    pairs = np.repeat(variance[..., 1:], 2, axis=-1)
    return np.asarray(np.nan_to_num(np.concatenate([variance[..., :1], pairs], axis=-1)))


def series(data: SweepRecords, rest: Remainder) -> Iterator[Series]:
    """Magnitude and phase of the driven line in channels along the drive, along frequency and along time."""
    lines = turned(data, rest)[..., 0]
    driven = np.flatnonzero(data.driven)
    by_frequency = driven[np.lexsort((data.begin[driven], data.frequency[driven]))]
    for row in data.along:
        for what, values in (("magnitude", lines[row].real), ("phase", lines[row].imag)):
            for order, along in ((by_frequency, "frequency"), (driven, "time")):
                where = f"{data.name} {data.channels.names[row]}, {what} along {along}"
                yield Series(where, values[order][data.usable[row][order]])


def order_of(component: str) -> int:
    """Place of a component among the lines of a record."""
    return domains().index(component)
