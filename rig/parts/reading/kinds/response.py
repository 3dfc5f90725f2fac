"""Foreign data of kind `response`: every table of a frequency response is a part."""

from __future__ import annotations

from dataclasses import replace

from rig.foreign.tables import Foreign
from rig.parts.reading.reading import Reading
from rig.parts.reading.response import responses
from rig.parts.reference_gain import channels_beside
from rig.parts.response import ResponseTable


def read(foreign: Foreign) -> Reading:
    """Every table. Raises BadInput for rows that are no numbers."""
    tables = (replace(data, channels=channels_beside(foreign, data.channels)) for data in responses(foreign))
    return Reading(tuple(ResponseTable(data) for data in tables))
