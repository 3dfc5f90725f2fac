"""The bench's own floor: smooth ripple of mounting and reference that no effect of the sensor explains.

Several mountings of the same unit differ by more than noise: adhesive, transverse motion and optics change the
response a little, smoothly over frequency. The floor is the size of that ripple, relative, and its length in log
frequency, found from the differences between three or more mountings by maximum likelihood (a Gaussian process per
channel and part of the complex response; Rasmussen and Williams 2006, ch. 2). It is carried by every fit as a nuisance
of that size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.errors import BadInput
from rig.fit.evidence import Evidence
from rig.motion import Array, Complexes
from rig.parts.sines import Sines

LENGTHS = (0.1, 0.2, 0.35, 0.6, 1.0)  # of the logarithm of frequency
SIZES = np.geomspace(1e-6, 1e-2, 41)
FEWEST = 3  # mountings
SMALLEST = 1e-2  # of the largest variance of a shape that is carried
NONE = 2.0  # logarithm of the likelihood by which a floor must beat none


@dataclass(frozen=True)
class Floor:
    """Ripple per mounting: `size` relative (standard deviation of each part), `length` in ln f, from `mountings`."""

    size: float
    length: float
    mountings: int
    runs: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For a YAML file."""
        return {"size": self.size, "length": self.length, "mountings": self.mountings, "runs": list(self.runs)}


def floor_from(stated: Mapping[str, Any], where: str) -> Floor:
    """The inverse of `as_dict`; raises BadInput."""
    wanted = "wanted size, length, mountings and runs of a floor"
    try:
        runs = tuple(map(str, stated["runs"]))
        found = Floor(float(stated["size"]), float(stated["length"]), int(stated["mountings"]), runs)
    except KeyError as error:
        raise BadInput(f"{where}: found no {error.args[0]}, {wanted}") from error
    except (TypeError, ValueError) as error:
        raise BadInput(f"{where}: found {error}, {wanted}") from error
    if not 0.0 <= found.size < 1.0 or not 0.0 < found.length < math.inf:
        raise BadInput(f"{where}: found size {found.size:g} and length {found.length:g}, {wanted}")
    return found


def floor_of(evidence: Evidence) -> Floor:
    """Measure the floor. Raises BadInput for fewer than three mountings of one axis or nothing in common."""
    groups: dict[str, list[Sines]] = {}
    for part in evidence.sines:
        groups.setdefault(part.data.axis, []).append(part)
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


def _differences(parts: Sequence[Sines]) -> list[_Table]:
    """Responses at the frequencies and levels that all mountings share, sensitivity and delay of each taken off."""
    responses = [_responses(part) for part in parts]
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


def _responses(part: Sines) -> dict[tuple[str, float, str], tuple[complex, float]]:
    """Response and relative variance of each part by channel, nominal frequency and level, for the driven axis."""
    data, found = part.data, {}
    for c, name in enumerate(data.channels.names):
        if data.channels.rates[c] or data.directions[data.channels.axis[c], 0] == 0.0:
            continue
        for p in np.flatnonzero((data.index >= 0) & data.usable[c]):
            shown = complex(data.shown[p, 1])
            relative = data.variance[c, p, 1] / abs(complex(data.observed[c, p, 1])) ** 2
            relative += data.reference_variance[p, 1] / abs(shown) ** 2
            key = (name, float(data.nominal[p]), data.level[p])
            found[key] = (complex(data.observed[c, p, 1]) / shown, float(relative))
    return found


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
    """Evidence whose parts on the shaker carry the floor as nuisances."""
    if evidence.sines:
        evidence = replace(evidence, blind=(*evidence.blind, said(floor)))
    if floor is None or floor.size == 0.0:
        return evidence
    parts = tuple(carrying(part, floor) if isinstance(part, Sines) else part for part in evidence.parts)
    return replace(evidence, parts=parts)


def carrying(part: Sines, floor: Floor) -> Sines:
    """The same part with the floor's shapes as nuisances: each part of the response of each driven accelerometer."""
    data = part.data
    made = Sines(data)
    f = np.where(data.frequency > 0.0, data.frequency, 1.0)
    shapes = _shapes(np.log(f), data.frequency > 0.0, floor)
    columns = []
    for c, axis in enumerate(data.channels.axis):
        if data.channels.rates[c] or data.directions[axis, 0] == 0.0:
            continue
        response = data.channels.sensitivity[c] / (1.0 + 1j * f / data.channels.pole[c])
        for shape in shapes.T:
            for turn in (1.0, 1j):
                raw = np.zeros(data.observed.shape, np.complex128)
                raw[c, :, 1] = turn * shape * response * data.shown[:, 1] * data.directions[axis, 0]
                columns.append(raw)
    made.extra = made.whitened(np.array(columns)) if columns else made.extra
    return made


def _shapes(log_f: Array, driven: np.ndarray[tuple[int], np.dtype[np.bool_]], floor: Floor) -> Array:
    """Ripple as independent shapes of one standard deviation each, (p, k): eigenvectors of the covariance."""
    distance = log_f[:, None] - log_f[None, :]
    covariance = np.exp(-0.5 * (distance / floor.length) ** 2) * np.outer(driven, driven)
    values, vectors = np.linalg.eigh(covariance)
    kept = values > SMALLEST * values[-1] * min(1.0, (1e-4 / max(floor.size, 1e-9)) ** 2 + 1e-3)
    return np.asarray(floor.size * vectors[:, kept] * np.sqrt(values[kept]))


def said(floor: Floor | None) -> str:
    """What is to be said of the floor, in one sentence."""
    if floor is None:
        return (
            "the bench's own floor is not known: ripple of mounting or reference looks like physics of the sensor "
            "(`rig run remounts.yaml && rig floor last`)"
        )
    if floor.size == 0.0:
        return f"floor: no ripple beyond noise between {floor.mountings} mountings"
    per_cent = 100.0 * floor.size * math.sqrt(2.0)
    return f"floor: {per_cent:.2g} % ripple per mounting ({floor.mountings} mountings), carried as a nuisance"


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
