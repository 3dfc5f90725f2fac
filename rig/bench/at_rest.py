"""At rest: static records, waits and what the operator does between them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rig.archive.writer import BlockStream
from rig.bench import at_shaker
from rig.bench.cube_record import CubeRecord
from rig.bench.station import Station, pace_of, samples_meta
from rig.bench.steps import Ask, Static, Wait
from rig.record import Samples

CHUNK = 1.0  # s; nothing longer than this is held in memory


def ask(step: Ask, station: Station) -> dict[str, Any]:
    """The operator does one thing; nothing is driven meanwhile."""
    at_shaker.rest(station)
    confirmation = station.ask(step.request)
    return {"said": confirmation.said}


def wait(step: Wait, station: Station) -> dict[str, Any]:
    """Let time pass, with signs of life for the guard."""
    at_shaker.rest(station)
    sleep(station, step.duration)
    return {}


def sleep(station: Station, seconds: float) -> None:
    """Sleep in pieces that the guard can follow."""
    while seconds > 0:
        piece = min(seconds, 10.0)
        station.guard.beat(within=piece + 10.0)
        station.room.clock.sleep(piece)
        seconds -= piece


def static(step: Static, station: Station) -> dict[str, Any]:
    """A record with nothing driven, however long: it goes to disk a second at a time."""
    at_shaker.rest(station)
    sleep(station, step.settle)
    body: dict[str, Any] = {"purpose": step.purpose, "cables": station.cables, "seconds": step.seconds}
    name = station.block_name(step.label)
    cube = CubeRecord(station, name) if station.keeps("cube") else None
    try:
        if station.keeps("recorder") or step.cables == "turntable":
            body |= _converter(step, station, name, cube)
        elif cube is not None:
            _cube_alone(step, station, cube)
    finally:
        if cube is not None:
            cube.keep()
    if cube is not None:
        cube.stop()
        body |= cube.said()
    return body


def _cube_alone(step: Static, station: Station, cube: CubeRecord) -> None:
    left = step.seconds
    while left > 1e-9:
        station.guard.beat(within=30.0)
        cube.take(min(left, CHUNK))
        left -= CHUNK


class _Taken:
    """What was taken of a record so far; it goes to disk as it comes."""

    def __init__(self, station: Station, name: str) -> None:
        self._station, self._name = station, name
        self._stream: BlockStream | None = None
        self._sums = np.zeros(2)
        self.scans, self.start = 0, 0.0
        self._pace: dict[str, Any] = {}

    def add(self, samples: Samples) -> None:
        with self._station.storing():
            if self._stream is None:
                self._stream = self._station.journal.block_stream(self._name, samples_meta(samples))
                self.start = samples.start
            self._stream.append(samples.counts)
        found = self._station.conditions(samples)
        means = [found.get("supply", math.nan), found.get("temperature", math.nan)]
        self._sums += np.array(means) * len(samples.counts)
        self.scans += len(samples.counts)
        self._pace = pace_of(samples)

    def keep(self) -> None:
        """Close what was taken, so that it survives whatever comes next."""
        if self._stream is not None:
            with self._station.storing():
                self._stream.close()

    def said(self) -> dict[str, Any]:
        supply, temperature = (self._sums / max(self.scans, 1)).tolist()
        conditions = {"supply": supply, "temperature": temperature}
        body = {"samples": self._name, "scans": self.scans, "start": self.start, "conditions": conditions}
        return body | self._pace


def _converter(step: Static, station: Station, name: str, cube: CubeRecord | None) -> dict[str, Any]:
    timing = station.wire()
    scans = math.ceil(step.seconds * timing.scan_rate - 1e-9)
    chunk = math.ceil(CHUNK * timing.scan_rate)
    station.recorder.start(scans)
    taken = _Taken(station, name)
    try:
        while taken.scans < scans:
            station.guard.beat(within=30.0)
            piece = min(scans - taken.scans, chunk)
            taken.add(station.read(piece))
            if cube is not None:
                cube.take(piece / timing.scan_rate)
            station.progress(f"{step.label} {taken.scans / timing.scan_rate:.0f} of {step.seconds:.0f} s")
    finally:
        taken.keep()
    return taken.said()
