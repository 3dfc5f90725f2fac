"""What data sheets say of the unit under test, channel by channel; SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rig import units


@dataclass(frozen=True)
class Sensor:
    """What the data sheet says of one channel; SI."""

    name: str
    quantity: str
    axis: str
    nominal: float
    bandwidth: float
    tolerance: float | None
    ratiometric: float | None
    drift: float | None

    @property
    def unit(self) -> str:
        """SI unit of what it senses."""
        return "m/s²" if self.quantity == "acceleration" else "rad/s"


def sensors_of(header: Mapping[str, Any]) -> dict[str, Sensor]:
    """The unit's channels as the run's header describes them."""
    found = {}
    for name, stated in header["sensor"]["channels"].items():
        kind = "sensitivity" if stated["quantity"] == "acceleration" else "rate_sensitivity"
        found[name] = Sensor(
            name, stated["quantity"], stated["axis"], units.parse(stated["sensitivity"], kind),
            units.parse(stated["bandwidth"], "frequency"), _optional(stated, "tolerance", "ratio"),
            _optional(stated, "ratiometric", "voltage"), _optional(stated, "temperature_coefficient", "ratio"),
        )  # fmt: skip
    return found


def _optional(stated: Mapping[str, Any], key: str, kind: str) -> float | None:
    return None if stated.get(key) is None else units.parse(stated[key], kind)
