"""The turntable's encoder (1000-line disk with HEDS-9040) as an instrument: three channels of the converter.

It has no link of its own; what its sampled outputs mean is decoded by `encoder`, here and in the analysis alike.
"""

from __future__ import annotations

from rig.record import Identity, Samples
from rig.room import Room
from rig.signals.encoder import LINES, Decoder, Lines, Settings, decode

MESSAGES: tuple[str, ...] = ()
"""The encoder cannot be spoken to."""


class Encoder:
    """The encoder as an instrument of the bench: it has no link of its own, only its place in the scan."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings

    def identify(self) -> Identity:
        """From the plate: there is nothing to ask."""
        return Identity("Avago", "HEDS-9040 with 1000-line disk", self._settings.serial, "none")

    def settings(self) -> dict[str, str | float | int | bool]:
        """Channels, thresholds (V), lines per revolution and sense."""
        return {**self._settings.model_dump(exclude={"serial"}), "lines": LINES}

    def decoder(self) -> Decoder:
        """For one record."""
        return Decoder(self._settings)

    def decode(self, samples: Samples) -> Lines:
        """A whole record at once."""
        return decode(samples, self._settings)

    def close(self) -> None:
        """Nothing to close."""


def connect(name: str, settings: Settings, room: Room) -> Encoder:
    """Nothing is opened."""
    return Encoder(settings)
