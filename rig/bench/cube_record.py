"""The Sensor Cube's own frames while another recorder works: read piece by piece, so that neither waits for the other.

A device that streams must be read within about a second, or the operating system throws its frames away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.bench.station import FRAMES, Station, cube_meta, frame_columns
from rig.record import CubeSamples


class CubeRecord:
    """One record of the cube; it goes to disk as it comes."""

    def __init__(self, station: Station, name: str) -> None:
        self._station, self.name = station, f"{name}-cube"
        self._streams: tuple[Any, Any] | None = None
        self._gaps = self._bad = 0
        self._clock: Mapping[str, Any] | None = None
        station.cube.configure()
        station.cube.start()

    def take(self, seconds: float) -> None:
        """The next stretch, s by the device's rate."""
        samples = self._station.cube.read(seconds)
        with self._station.storing():
            if self._streams is None:
                journal = self._station.journal
                meta, frames = cube_meta(samples), {"kind": "cube_frames", "columns": list(FRAMES)}
                self._streams = (
                    journal.block_stream(self.name, meta),
                    journal.block_stream(f"{self.name}-frames", frames),
                )
            self._streams[0].append(samples.counts)
            self._streams[1].append(frame_columns(samples))
        self._gaps, self._bad = self._gaps + samples.gaps, self._bad + samples.bad_frames
        self._clock = None if samples.clock is None else asdict(samples.clock)

    def keep(self) -> None:
        """Close what was taken, so that it survives whatever comes next."""
        if self._streams is not None:
            with self._station.storing():
                for stream in self._streams:
                    stream.close()

    def stop(self) -> None:
        """End the record at the device."""
        self._station.cube.stop()

    def said(self) -> dict[str, Any]:
        """What to write of the record in the journal; nothing if nothing came."""
        if self._streams is None:
            return {}
        return {
            "cube": self.name, "cube_gaps": self._gaps, "cube_bad_frames": self._bad, "cube_clock": self._clock,
        }  # fmt: skip


def joined(one: CubeSamples, two: CubeSamples) -> CubeSamples:
    """Two consecutive stretches of a record; the clock is the later one's, which knows all arrivals."""
    columns: dict[str, NDArray[Any]] = {
        name: np.concatenate([getattr(one, name), getattr(two, name)]) for name in ("counts", *FRAMES)
    }
    return replace(two, **columns, gaps=one.gaps + two.gaps, bad_frames=one.bad_frames + two.bad_frames)  # type: ignore[arg-type]
