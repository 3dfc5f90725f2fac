"""Imported runs as parts of a fit: one way in for every kind of foreign data."""

from __future__ import annotations

from rig.errors import BadInput
from rig.estimate.fit import Part
from rig.estimate.responding import Responding, responses
from rig.foreign import Foreign
from rig.model import Term


def parts_of(foreign: Foreign) -> tuple[list[Part], list[Term]]:
    """Parts of an imported run, and what is known of its reference only within an uncertainty.

    Raises BadInput for data of a kind that no model can be compared with.
    """
    kind = foreign.manifest.kind
    if kind == "response":
        return [Responding(data) for data in responses(foreign)], []
    raise BadInput(f"{foreign.run}: found data of kind {kind}, wanted one that a model can be compared with")
