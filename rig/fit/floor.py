"""The bench's own floor: smooth ripple of mounting and reference that no effect of the sensor explains.

Several mountings of the same unit differ by more than noise: adhesive, transverse motion and optics change the
response a little, smoothly over frequency. The floor is the size of that ripple, relative, and its length in log
frequency, found from the differences between three or more mountings by maximum likelihood (a Gaussian process per
channel and part of the complex response; Rasmussen and Williams 2006, ch. 2). It is carried by every fit as a nuisance
of that size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rig.errors import BadInput
from rig.fit.evidence import Evidence
from rig.motion import Array, Complexes
from rig.parts.part import Part
from rig.parts.ripple import Floor, floor_from

LENGTHS = (0.1, 0.2, 0.35, 0.6, 1.0)  # of the logarithm of frequency
SIZES = np.geomspace(1e-6, 1e-2, 41)
FEWEST = 3  # mountings
NONE = 2.0  # logarithm of the likelihood by which a floor must beat none


def floor_of(evidence: Evidence) -> Floor:
    """Measure the floor. Raises BadInput for fewer than three mountings of one axis or nothing in common."""
    groups: dict[str, list[Part]] = {}
    for part in (one for one in evidence.parts if one.mounting):
        groups.setdefault(part.mounting, []).append(part)
    usable = {axis: parts for axis, parts in groups.items() if len(parts) >= FEWEST}
    if not usable:
        most = max((len(parts) for parts in groups.values()), default=0)
        raise BadInput(f"floor: found {most} mountings of one axis, wanted at least {FEWEST} (see remounts.yaml)")
    tables = [one for parts in usable.values() for one in _differences(parts)]
    if not tables:
        raise BadInput("floor: found no frequency and level that all mountings share, wanted the same sweep every time")
    best, size, length = 0.0, 0.0, LENGTHS[-1]
    for trial in LENGTHS:
        for one in SIZES:
            gain = sum(_likelihood(table, float(one), trial) for table in tables)
            if gain > best + (NONE if size == 0.0 else 0.0):
                best, size, length = gain, float(one), trial
    return Floor(size, length, max(map(len, usable.values())), evidence.runs)


@dataclass(frozen=True)
class _Table:
    """Differences of one channel from the mean over mountings: ln f (p,), relative (m, p), variance of the noise."""

    log_frequency: Array
    relative: Complexes
    variance: Array


def _differences(parts: Sequence[Part]) -> list[_Table]:
    """Responses at the frequencies and levels that all mountings share, sensitivity and delay of each taken off."""
    responses = [part.responses() for part in parts]
    shared = [key for key in responses[0] if all(key in other for other in responses[1:])]
    tables = []
    for channel in dict.fromkeys(key[0] for key in shared):
        keys = sorted(key for key in shared if key[0] == channel)
        log_f = np.log([key[1] for key in keys])
        values = np.array([[one[key][0] for key in keys] for one in responses])
        variance = np.array([[one[key][1] for key in keys] for one in responses]).mean(axis=0)
        relative = values / values.mean(axis=0) - 1.0
        tables.append(_Table(log_f, relative, variance))
    return tables


def _likelihood(table: _Table, size: float, length: float) -> float:
    """Gain of the logarithm of the likelihood over no floor, for deviations from the mean of m mountings."""
    m = len(table.relative)
    distance = table.log_frequency[:, None] - table.log_frequency[None, :]
    share = 1.0 - 1.0 / m
    noise = np.diag(table.variance) * share
    whole = noise + size**2 * share * np.exp(-0.5 * (distance / length) ** 2)
    rows = np.concatenate([table.relative.real, table.relative.imag])
    degrees = 2.0 * (m - 1)
    scatter = rows.T @ rows / (2.0 * m)  # its expectation is the covariance with the share above
    gain = 0.0
    for covariance, sign in ((whole, 1.0), (noise, -1.0)):
        _, log_det = np.linalg.slogdet(covariance)
        gain += -0.5 * sign * degrees * (log_det + float(np.trace(np.linalg.solve(covariance, scatter))))
    return gain


def with_floor(evidence: Evidence, floor: Floor | None) -> Evidence:
    """Evidence whose mountings carry the floor as nuisances."""
    more = tuple(dict.fromkeys(one for part in evidence.parts for one in part.said_of_ripple(floor)))
    parts = tuple(part.with_ripple(floor) for part in evidence.parts)
    return replace(evidence, parts=parts, blind=(*evidence.blind, *more))


def path_of(runs: Path) -> Path:
    """Where a runs folder keeps its floor."""
    return runs / "floor.yaml"


def save(path: Path, floor: Floor) -> None:
    """Write a floor as YAML, whole or not at all."""
    import yaml

    from rig.archive.durable import write_whole

    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, yaml.safe_dump(floor.as_dict(), sort_keys=False).encode())


def load(path: Path) -> Floor | None:
    """The floor of a runs folder, None if none was measured. Raises BadInput for a file that is no floor."""
    from rig.yaml import document

    if not path.exists():
        return None
    data = document.read(path).data
    if not isinstance(data, dict):
        raise BadInput(f"{path}: found {data!r}, wanted size, length, mountings and runs of a floor")
    return floor_from(data, str(path))
