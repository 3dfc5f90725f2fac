"""Which key of a manifest says something about which kind of data: what no code would read is refused, not kept.

    refused("poses", "device", "rate", {"delay"})      # [("delay", "nothing: …")]

A rule is where a key is read: kinds of data, and for columns the roles and quantities in them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass

ALL = frozenset({"response", "sweep", "rotation", "motion", "poses", "static"})
MOVING = frozenset({"rotation", "motion"})
LINES = frozenset({"line_a", "line_b", "index_line"})
FELT = frozenset({"acceleration", "rate", "unstated", "voltage"})
RATIO = frozenset({"magnitude", "real"})


@dataclass(frozen=True)
class Read:
    """Where a column's key is read; empty sets stand for all."""

    kinds: frozenset[str] = frozenset()
    role: str = ""
    quantities: frozenset[str] = frozenset()

    def holds(self, kind: str, role: str, quantity: str) -> bool:
        """Whether it is read for a column of such data."""
        return (
            (not self.kinds or kind in self.kinds)
            and self.role in ("", role)
            and (not self.quantities or quantity in self.quantities)
        )


def _at(kinds: str, role: str = "", quantities: Set[str] = frozenset()) -> Read:
    return Read(frozenset(kinds.split()), role, frozenset(quantities))


_UNCERTAIN = (_at("response", "device"), _at("rotation", "reference", {"angle"}))
COLUMNS: Mapping[str, tuple[Read, ...]] = {
    "component": (_at("motion", "reference", {"quaternion"}),),
    "tolerance": (_at("", "device", FELT | RATIO),),
    "bandwidth": (_at("sweep rotation motion", "device", FELT), _at("response", "device", RATIO)),
    "delay": (
        _at("sweep rotation motion", "device"), _at("sweep", "reference"),
        _at("rotation", "reference", LINES | {"angle"}), _at("motion", "reference", {"position", "quaternion"}),
    ),
    "uncertainty": _UNCERTAIN, "uncertainty_column": _UNCERTAIN, "coverage": _UNCERTAIN,
    "gain_uncertainty": (
        _at("rotation", "reference", {"angle"}), _at("motion", "reference", {"position"}),
        _at("sweep", "reference", {"acceleration", "unstated", "voltage"}),
        _at("response", "reference", {"excitation"}), _at("response", "device", RATIO),
    ),
}  # fmt: skip
FILE: Mapping[str, frozenset[str]] = {
    "time": ALL - {"response"}, "rotation": frozenset({"rotation"}), "pose": frozenset({"motion"}),
    "segments": frozenset({"poses", "rotation"}), "mains": frozenset({"sweep"}), "gravity": ALL - {"static"},
    "gravity.uncertainty": frozenset({"poses"}), "standard": ALL - {"static"},
    "compared": ALL - {"static", "response", "sweep"},
    "compared.rate_band": MOVING, "compared.force_band": MOVING, "compared.held_out": MOVING | {"poses"},
}  # fmt: skip
INSTEAD: Mapping[tuple[str, str], str] = {
    ("poses", "gain_uncertainty"): ": gravity is the reference, and gravity.uncertainty says how well it is known",
    ("response", "delay"): ": a response's phase has it already",
    ("response", "gain_uncertainty"): ": it belongs to the excitation, or to the magnitude",
    ("motion", "gain_uncertainty"): ": it belongs to the positions",
    ("rotation", "gain_uncertainty"): ": it belongs to the reference's angle; an encoder's lines close in a turn",
    ("response", "compared"): ": `held_out: true` marks a file, else every third frequency is held out",
    ("sweep", "compared"): ": `held_out: true` marks a file, else every third point is held out",
}


def of_column(kind: str, role: str, quantity: str, stated: Set[str]) -> Iterator[tuple[str, str]]:
    """Keys of a column that nothing would read, each with what was wanted."""
    for key, places in COLUMNS.items():
        if key in stated and not any(one.holds(kind, role, quantity) for one in places):
            yield key, f"wanted nothing in a {role} column of {quantity} of a {kind}{INSTEAD.get((kind, key), '')}"


def of_file(kind: str, stated: Set[str]) -> Iterator[tuple[str, str]]:
    """The same for keys of the file, such as "mains" or "compared.rate_band"; of what is nested the outer one first."""
    for key, kinds in FILE.items():
        outer = key.partition(".")[0]
        if key in stated and kind not in kinds and (outer == key or kind in FILE[outer]):
            yield key, f"wanted nothing for a {kind}{INSTEAD.get((kind, key), '')}"
