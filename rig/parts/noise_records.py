"""What records at rest show of the sensors' own noise: bands of their spectra, and what the data sheets say of it."""

from __future__ import annotations

from dataclasses import dataclass

from rig.model import Array, Channels
from rig.signals.rest_spectrum import Bands
from rig.signals.sheet_noise import Sheet


@dataclass(frozen=True)
class NoiseRecords:
    """Records at rest of one experiment at a `place`, c channels whose noise a data sheet states, at `rate` Hz.

    `trained` bands, V²/Hz, of those that levels are found from, `held` of every third; `sheet` V²/Hz by the data
    sheet's sensitivities; `seconds` of all of them together. `walk` V²·Hz (c,) is a random walk of the zeros, if shown.
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
    notes: tuple[str, ...] = ()
