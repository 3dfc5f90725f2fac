"""What records at rest show of the sensors' own noise: bands of their spectra, and what the data sheets say of it."""

from __future__ import annotations

from dataclasses import dataclass

from rig.model import Array, Channels, Quantity
from rig.signals.rest_lines import Line
from rig.signals.rest_spectrum import Bands
from rig.signals.sheet_noise import Sheet


@dataclass(frozen=True)
class Shown:
    """A line in the channels of one quantity: `amplitude` and `u` SI, or V where it was `folded` from that many Hz."""

    on: Quantity
    line: Line
    folded: float
    amplitude: float
    u: float


@dataclass(frozen=True)
class NoiseRecords:
    """Records at rest of one experiment at a `place`, c channels whose noise a data sheet states, at `rate` Hz.

    `trained` bands, V²/Hz, of those that levels are found from, `held` of every third; `sheet` V²/Hz by the data
    sheet's sensitivities; `seconds` of all of them together. `walk` V²·Hz (c,) is a random walk of the zeros, if shown.
    `coarse`: distance of the codes that records use, V, its standard uncertainty, and in how many channels.
    """

    name: str
    run: str
    place: str
    channels: Channels
    rate: float
    seconds: float
    trained: Bands
    held: Bands | None
    sheet: Sheet
    walk: Array
    lines: tuple[Shown, ...] = ()
    coarse: tuple[float, float, int] = (0.0, 0.0, 0)
    notes: tuple[str, ...] = ()
