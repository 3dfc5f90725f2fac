"""What turntable runs tell beside their fit: lines counted between index pulses, and what they lack."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from rig.parts.platter_records import PlatterRecords
from rig.parts.remainder import Sign

MOVING = 0.5  # rad/s


def signs(runs: Sequence[PlatterRecords]) -> Iterator[Sign]:
    """Lines that are missing between index pulses."""
    lost, lines = sum(data.lost for data in runs), sum(data.lines for data in runs)
    if lost:
        because = f"{lost} of {lines} lines are missing between index pulses, each where an interval is twice as long"
        # a line that is missing is no matter of noise
        yield Sign("missed_counts", {"share": lost / lines}, {"share": math.sqrt(lost) / lines}, 1000.0 * lost, because)

    for data in runs:
        rms, u, evidence = data.graduation
        if evidence > 0.0:
            because = (
                f"the encoder's lines err by {rms:.2g} rad rms in a pattern over many lines, the same at both speeds: "
                "lines that err each for themselves leave none"
            )
            yield Sign("encoder_graduation", {"rms": rms}, {"rms": u}, evidence, because)


def lacks(runs: Sequence[PlatterRecords]) -> Iterator[str]:
    """What these runs cannot show."""
    if not runs:
        yield "no turntable run: everything that only a rate shows, the gyros' nonlinearity and asymmetry among it"
        return
    if len({sign for data in runs for sign in _senses(data)}) == 1:
        yield "one sense of rotation only: asymmetry and even nonlinearity of the gyros hide in their sensitivity"
    if not any(bool(np.any(np.abs(data.counted.rate) < MOVING)) for data in runs):
        yield "no static record on the turntable: zero output of the gyros and its drift"


def _senses(data: PlatterRecords) -> list[float]:
    """The encoder turns one way; which way the unit feels it depends on what is up."""
    rate = data.counted.rate
    up = data.up[np.argmax(np.abs(data.up), axis=0), np.arange(data.up.shape[1])]
    felt = (rate * up)[np.abs(rate) > MOVING]
    return [float(one) for one in np.unique(np.sign(felt[np.isfinite(felt)]))]


def unmeasured(runs: Sequence[PlatterRecords]) -> Iterator[tuple[str, str]]:
    """What a turntable run could still measure, and the command."""
    if not runs:
        yield "no turntable run: nothing that only a rate shows", "rig turntable --all"
