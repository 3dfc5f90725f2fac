"""The bench's own ripple of mounting and reference, as a part carries it: smooth shapes over frequency.

Its size and length come from three or more mountings (`rig floor`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.errors import BadInput
from rig.motion import Array
from rig.parts.remainder import Mask

SMALLEST = 1e-2  # of the largest variance of a shape that is carried


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

    def shapes(self, log_f: Array, driven: Mask) -> Array:
        """Ripple as independent shapes of one standard deviation each, (p, k): eigenvectors of the covariance."""
        distance = log_f[:, None] - log_f[None, :]
        covariance = np.exp(-0.5 * (distance / self.length) ** 2) * np.outer(driven, driven)
        values, vectors = np.linalg.eigh(covariance)
        kept = values > SMALLEST * values[-1] * min(1.0, (1e-4 / max(self.size, 1e-9)) ** 2 + 1e-3)
        return np.asarray(self.size * vectors[:, kept] * np.sqrt(values[kept]))


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


ELSEWHERE = (
    "how much ripple a mounting makes is not known here: it looks like physics of the sensor; mounted once more, the "
    "sensor would show it again and the mounting would not"
)


def said(floor: Floor | None) -> str:
    """What is to be said of the ripple, in one sentence."""
    if floor is None:
        return (
            "the bench's own floor is not known: ripple of mounting or reference looks like physics of the sensor "
            "(`rig run remounts.yaml && rig floor last`)"
        )
    if floor.size == 0.0:
        return f"floor: no ripple beyond noise between {floor.mountings} mountings"
    per_cent = 100.0 * floor.size * math.sqrt(2.0)
    return f"floor: {per_cent:.2g} % ripple per mounting ({floor.mountings} mountings), carried as a nuisance"
