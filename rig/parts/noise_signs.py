"""What records at rest tell beside their spectra: narrow lines, and codes that the converter leaves out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rig.parts.noise_records import NoiseRecords, Shown
from rig.parts.remainder import Sign

CODES = 100.0  # evidence of a channel whose codes are left out, as χ²: no noise does that


def signs(rests: Sequence[NoiseRecords]) -> Iterator[Sign]:
    """Lines of channels of one quantity, and coarse codes."""
    for data in rests:
        for shown in data.lines:
            yield _line(shown)
        step, u, count = data.coarse
        if count:
            because = f"only every {step * 1e3:.3g} mV occurs in {count} of {len(data.channels.names)} channels at rest"
            yield Sign("quantisation", {"step": step}, {"step": u}, CODES * count, because)


def _line(shown: Shown) -> Sign:
    line, was = shown.line, math.isfinite(shown.folded)
    frequency = shown.folded if was else line.frequency
    what = f"a line at {line.frequency:.4g} Hz, no multiple of the mains, at rest in the {shown.on} channels"
    why = ", at phases of the scan as it would have at"
    because = f"{what}{why} {shown.folded:.6g} Hz (or that and whole reciprocals of a slot more)" if was else what
    at = {"amplitude": shown.amplitude, "frequency": frequency}
    u = {"amplitude": shown.u, "frequency": line.u}
    return Sign("aliasing" if was else "spur", at, u, line.evidence, because, shown.on)
