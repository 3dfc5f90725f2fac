"""From the rig's own records at rest to bands of their spectra, channel by channel, at the converter's full rate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rig import units
from rig.archive.records import Recorded, experiments, is_imported, signals, statics
from rig.archive.reduced import reduced
from rig.model import BOTH, Channels
from rig.motion import Array
from rig.parts.channels import channels_of
from rig.parts.noise_records import NoiseRecords, Shown
from rig.parts.noise_spectrum import NoiseSpectrum
from rig.parts.reading.reading import Reading
from rig.sensor import Sensor
from rig.signals.rest_lines import Line, coarse_step, folded, strongest
from rig.signals.rest_spectrum import Bands, bands
from rig.signals.sheet_noise import Levels, Sheet

POSE = "pose"  # of a record after which a hand comes
PIECE = 30.0  # s
SHORTEST = 4.0  # s
MOST, MOST_LINES = 60, 10  # pieces, in all and of those in which lines are looked for
LEAST = 0.75  # of a coarse step: standard deviation of a channel whose spectrum can be judged
HELD, EVERY = 1, 3  # the second of every three is held out


def read(runs: Sequence[Recorded]) -> Reading:
    """All records at rest of the rig's own runs, those of one experiment together."""
    own = [run for run in runs if not is_imported(run)]
    return Reading(tuple(NoiseSpectrum(data) for run in own for data in rested(run)))


def rested(records: Recorded) -> list[NoiseRecords]:
    """Every experiment's records at rest; none where no data sheet states a noise."""
    kinds = (NoiseRecords, Channels, Bands, Sheet, Shown, Line)
    return reduced(records, "noise", kinds, lambda: list(_rested(records)))


def _rested(records: Recorded) -> Iterator[NoiseRecords]:
    number = 0
    for one in experiments(records):
        bodies = [body for body in statics(one) if body["purpose"] != POSE and "cables" in body]
        for place in dict.fromkeys(str(body["cables"]) for body in bodies):
            mine = [body for body in bodies if body["cables"] == place]
            if (found := _noise(one, place, mine, f"{records.name}#noise{number or ''}")) is not None:
                yield found
                number += 1


def _noise(records: Recorded, place: str, bodies: Sequence[Mapping[str, Any]], name: str) -> NoiseRecords | None:
    cables = list(records.header["bench_file"]["cables"][place])
    sensor = Sensor.of(records.header)
    stated = [one for one in cables if one in sensor and sensor.channel(one).noise is not None]
    if not stated:
        return None
    every = channels_of(records, cables)
    channels = every.only(np.array([every.names.index(one) for one in stated]))
    pieces, rate, step, period = _pieces(records, bodies, stated)
    if not pieces:
        return None
    coarse = _coarse(pieces, step)
    rough = np.std(pieces[0], axis=0) < LEAST * coarse[0]  # what is added is then not noise of its own
    if rough.all():
        return None
    pieces, channels = [one[:, ~rough] for one in pieces], channels.only(np.flatnonzero(~rough))
    mains = units.parse(str(records.header["bench_file"]["mains"]), "frequency")
    held = [piece for n, piece in enumerate(pieces) if n % EVERY == HELD]
    trained = bands([piece for n, piece in enumerate(pieces) if n % EVERY != HELD], rate, mains)
    if trained is None:
        return None
    seconds = sum(len(piece) for piece in pieces) / rate
    sheet = _sheet(sensor, channels, step, rate)
    walk = Levels(sheet, rate, trained).walks(channels.rates, channels.sensitivity**2)
    later = bands(held, rate, mains) if held else None
    lines = tuple(_lines(pieces, channels, rate, mains, period))
    return NoiseRecords(name, records.name, place, channels, rate, seconds, trained, later, sheet, walk, lines, coarse)


def _pieces(
    records: Recorded, bodies: Sequence[Mapping[str, Any]], names: Sequence[str]
) -> tuple[list[Array], float, float, float]:
    """Pieces of all records, each (n, channels), V, with their rate (Hz), the converter's step (V), and time of a
    conversion (s).
    """
    found: list[Array] = []
    rate = step = period = 0.0
    for body in bodies:
        waiting = np.zeros((0, len(names)))
        for stretch in records.pieces(str(body["samples"])):
            if len(found) >= MOST:
                break
            one = signals(stretch)
            rate, step, period = 1.0 / stretch.timing.scan_period, one.step, stretch.timing.convert_period
            waiting = np.concatenate([waiting, one.volts[:, [one.column(name) for name in names]]])
            size = round(PIECE * rate)
            while len(waiting) >= size and len(found) < MOST:
                found.append(waiting[:size])
                waiting = waiting[size:]
        if len(waiting) >= SHORTEST * max(rate, 1.0) and len(found) < MOST:
            found.append(waiting)
    return found, rate, step, period


def _lines(pieces: Sequence[Array], channels: Channels, rate: float, mains: float, period: float) -> Iterator[Shown]:
    """The strongest line of the channels of each quantity, in the longest pieces."""
    longest = max(len(one) for one in pieces)
    whole = [one for one in pieces if len(one) == longest][:MOST_LINES]
    for on in BOTH:
        rows = channels.of(on)
        if not len(rows) or (line := strongest([one[:, rows] for one in whole], rate, mains)) is None:
            continue
        was = folded(line, np.asarray(channels.slot[rows] * period, np.float64), rate)
        scale = np.ones(len(rows)) if was else np.abs(channels.sensitivity[rows])
        weight = (scale / line.u_amplitude) ** 2
        amplitude = float(weight @ (line.amplitude / scale) / weight.sum())
        yield Shown(on, line, math.nan if was is None else was, amplitude, float(weight.sum()) ** -0.5)


def _coarse(pieces: Sequence[Array], step: float) -> tuple[float, float, int]:
    """Distance of the codes that the records use, V, its u, and the number of channels where codes are left out."""
    found = [
        one for values in pieces[0].T if (one := coarse_step(np.round((values - values.min()) / step))) is not None
    ]
    if not found:
        return 0.0, 0.0, 0
    best = min(found, key=lambda one: one[1])
    return best[0] * step, best[1] * step, len(found)


def _sheet(sensor: Sensor, channels: Channels, step: float, rate: float) -> Sheet:
    stated = [noise for name in channels.names if (noise := sensor.channel(name).noise) is not None]
    corners = np.log([one.corner for one in stated])
    return Sheet(
        density=np.array([one.density for one in stated]) ** 2 * channels.sensitivity**2,
        u_level=2.0 * np.array([one.tolerance for one in stated]),
        pole=channels.pole,
        corner=np.exp(corners.mean(axis=1)),
        u_corner=np.maximum((corners[:, 1] - corners[:, 0]) / math.sqrt(12.0), 0.1),
        rounding=np.full(len(stated), step**2 / 6.0 / rate),
    )
