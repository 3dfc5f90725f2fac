"""What records at rest tell beside their spectra: narrow lines, and codes that the converter leaves out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rig.parts.noise_records import NoiseRecords, Shown
from rig.parts.remainder import Sign
from rig.signals.rest_lines import FEWEST

FAR = 4.0  # standard uncertainties: frequencies as far apart are two
DRIFT = 2e-5  # relative: by as much a line and the board's clock may move between two runs
CODES = 100.0  # evidence of a channel whose codes are left out, as χ²: no noise does that


def signs(rests: Sequence[NoiseRecords]) -> Iterator[Sign]:
    """Lines of channels of one quantity, and coarse codes."""
    for same in _same([shown for data in rests for shown in data.lines]):
        yield _line(max(same, key=lambda shown: (len(shown.line.amplitude) >= FEWEST, shown.line.evidence)))
    for data in rests:
        step, u, count = data.coarse
        if count:
            because = f"only every {step * 1e3:.3g} mV occurs in {count} of {len(data.channels.names)} channels at rest"
            yield Sign("quantisation", {"step": step}, {"step": u}, CODES * count, because)


def _same(lines: Sequence[Shown]) -> list[list[Shown]]:
    """Lines of one quantity that lie at one frequency as far as anybody can tell: one and the same, seen in several
    records; too few channels in some to tell whether it was folded.
    """
    found: list[list[Shown]] = []
    for one in lines:
        near = [group for group in found if group[0].on == one.on and _at_one(group[0], one)]
        if near:
            near[0].append(one)
        else:
            found.append([one])
    return found


def _at_one(one: Shown, other: Shown) -> bool:
    apart = abs(one.line.frequency - other.line.frequency)
    highest = max(f for f in (one.line.frequency, one.folded, other.folded) if math.isfinite(f))
    return apart < FAR * math.hypot(one.line.u, other.line.u) + DRIFT * highest


def _line(shown: Shown) -> Sign:
    line, was = shown.line, math.isfinite(shown.folded)
    frequency = shown.folded if was else line.frequency
    what = f"a line at {line.frequency:.4g} Hz, no multiple of the mains, at rest in the {shown.on} channels"
    why = ", at phases of the scan as it would have at"
    because = f"{what}{why} {shown.folded:.6g} Hz (or as far from any multiple of the slots' rate)" if was else what
    at = {"amplitude": shown.amplitude, "frequency": frequency}
    u = {"amplitude": shown.u, "frequency": line.u}
    return Sign("aliasing" if was else "spur", at, u, line.evidence, because, shown.on)
