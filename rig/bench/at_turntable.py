"""At the turntable: every phase is one record, decoded while it is taken, so that the encoder says when it is good."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.bench.cube_record import CubeRecord
from rig.bench.station import A_PERSON, Station, pace_of, samples_meta
from rig.bench.steps import Spin, touch_request
from rig.errors import VerdictNotMet
from rig.record import Samples

LOOK = 0.5  # s of record between two looks at the encoder
COAST_AT_MOST = 120.0  # s for the platter to come to rest
KEPT = 2.5  # s of line edges kept for the next look; more than one revolution at 33⅓ rpm


class WatchedRecord:
    """A record that goes to disk and through the encoder's decoder a stretch at a time; memory stays bounded."""

    def __init__(self, step: Spin, station: Station) -> None:
        self._station, self._step = station, step
        self.name = station.block_name(step.label)
        timing = station.wire()
        self._scans, self._scan_period = math.ceil(LOOK / timing.scan_period), timing.scan_period
        self._decoder = station.encoder.decoder()
        self._stream: Any = None
        self._edges: NDArray[np.float64] = np.zeros(0)
        self._last_index = -math.inf
        self.taken, self.missed, self.sense = 0, 0, 0
        self.flagged: list[int] = []
        self.revolutions: list[Any] = []
        self.conditions: dict[str, float] = {}
        self._pace: dict[str, Any] = {}
        self._cube = CubeRecord(station, self.name) if station.keeps("cube") else None
        station.recorder.start(None)

    @property
    def now(self) -> float:
        """Length of the record so far, s."""
        return self.taken * self._scan_period

    def look(self) -> tuple[float, list[Any]]:
        """Take the next stretch; gives the record's length (s) and the revolutions that it completed."""
        station = self._station
        station.guard.beat(within=30.0)
        samples = station.read(self._scans)
        self._keep(samples)
        if self._cube is not None:
            self._cube.take(self._scans * self._scan_period)
        with station.watch("analysis"):
            completed = self._decoded(samples)
        self.revolutions += completed
        station.progress(f"{self._step.label}: {len(self.revolutions)} revolutions")
        return self.now, completed

    def at_rest(self) -> bool:
        """Whether the platter has come to rest."""
        return bool(self._station.turntable.at_rest(self._edges, self.now))

    def keep(self) -> None:
        """Close what was taken so far, so that it survives whatever comes next."""
        if self._stream is not None:
            with self._station.storing():
                self._stream.close()
        if self._cube is not None:
            self._cube.keep()

    def stop(self) -> None:
        """End the record at the instruments."""
        self._station.recorder.stop()
        if self._cube is not None:
            self._cube.stop()

    def said(self) -> dict[str, Any]:
        """What to write of the record in the journal."""
        return {
            "samples": self.name,
            "scans": self.taken,
            "seconds": self.now,
            "conditions": self.conditions,
            "revolutions_seen": len(self.revolutions),
            "missed_index": self.missed,
            "flagged_counts": self.flagged,
            **self._pace,
            **({} if self._cube is None else self._cube.said()),
        }

    def _keep(self, samples: Samples) -> None:
        with self._station.storing():
            if self._stream is None:
                self._stream = self._station.journal.block_stream(self.name, samples_meta(samples))
            self._stream.append(samples.counts)
        self.taken += len(samples.counts)
        self.conditions = self._station.conditions(samples)
        self._pace = pace_of(samples)

    def _decoded(self, samples: Samples) -> list[Any]:
        lines = self._decoder.feed(samples)
        self.missed += lines.missed
        self.flagged += lines.flagged
        self.sense = lines.sense or self.sense
        self._edges = np.concatenate([self._edges, lines.edges])
        index = lines.index
        if math.isfinite(self._last_index):
            index = np.concatenate([[self._last_index], index])
        completed = self._station.turntable.completed(self._edges, index, self.sense) if len(index) > 1 else []
        if len(lines.index):
            self._last_index = float(lines.index[-1])
        oldest = min(self._last_index if math.isfinite(self._last_index) else self.now, self.now - KEPT)
        self._edges = self._edges[self._edges >= oldest - 1.0]
        return list(completed)


def spin(step: Spin, station: Station) -> dict[str, Any]:
    """One phase of a turntable run; returns the body of its journal line. Raises VerdictNotMet with the reason."""
    record = WatchedRecord(step, station)
    common = {"phase": step.phase, "rpm": step.rpm, "gyro_axis": step.gyro_axis, "inverted": step.inverted}
    try:
        found = _PHASES[step.phase](step, station, record)
    finally:
        record.keep()
    record.stop()
    return {**common, **record.said(), **found}


def _spin_up(step: Spin, station: Station, record: WatchedRecord) -> dict[str, Any]:
    _speed(station, step.rpm)
    verdict = station.turntable.wait_until_steady(record.look, started=record.now)
    return {"gate": asdict(verdict)}


def _hold(step: Spin, station: Station, record: WatchedRecord) -> dict[str, Any]:
    """Whole revolutions from index to index; the gate judges all of them and must be open at the end."""
    gate = station.turntable.gate(rpm=step.rpm)
    patience = (step.revolutions + 3) * 60.0 / step.rpm * 1.5 + 5.0
    while len(record.revolutions) < step.revolutions:
        now, completed = record.look()
        for revolution in completed:
            gate.feed(revolution)
        if gate.verdict.state == "failed" or now > patience:
            reason = gate.verdict.reason or "too slow"
            raise VerdictNotMet(f"{step.label}: found {reason}, wanted {step.revolutions} steady revolutions")
    if gate.verdict.state != "steady" and step.phase == "hold" and step.revolutions > 5:
        raise VerdictNotMet(f"{step.label}: found {gate.verdict.reason} at the end, wanted a steady platter")
    return {**_whole(step, record), "gate": asdict(gate.verdict)}


def _perturbed(step: Spin, station: Station, record: WatchedRecord) -> dict[str, Any]:
    """Revolutions under a light touch: recorded as they come, with no gate on the rate."""
    station.ask(touch_request(step.fraction))
    patience = (step.revolutions + 3) * 60.0 / step.rpm * 2.0 + 5.0
    while len(record.revolutions) < step.revolutions:
        if record.look()[0] > patience:
            raise VerdictNotMet(f"{step.label}: found {len(record.revolutions)} revolutions, wanted {step.revolutions}")
    return _whole(step, record)


def _coast_down(step: Spin, station: Station, record: WatchedRecord) -> dict[str, Any]:
    _speed(station, 0.0)
    while not record.at_rest():
        if record.look()[0] > COAST_AT_MOST:
            raise VerdictNotMet(
                f"{step.label}: found the platter still turning after {COAST_AT_MOST:g} s, wanted it at rest"
            )
    station.platter = "standing"
    return {}


def _whole(step: Spin, record: WatchedRecord) -> dict[str, Any]:
    """Mean rate (rad/s, negative clockwise from above) over the whole revolutions, index to index."""
    turns = record.revolutions[: step.revolutions]
    begin, end = turns[0].begin, turns[-1].end
    direction = turns[-1].direction or -1
    rate = direction * 2.0 * math.pi * len(turns) / (end - begin)
    return {"revolutions": len(turns), "first_index": begin, "last_index": end, "rate": rate}


def _speed(station: Station, rpm: float) -> None:
    """The record runs already, so that the whole change of speed is in it."""
    station.platter = "turning"
    station.guard.expect(A_PERSON)
    confirmation = station.turntable.set_speed(rpm)
    station.journal.note(
        "confirmed",
        action="turntable_speed",
        settings=dict(confirmation.request.settings),
        text=confirmation.request.text,
        who=confirmation.who,
        when=confirmation.when,
        said=confirmation.said,
    )


_PHASES = {"spin_up": _spin_up, "hold": _hold, "perturbed": _perturbed, "coast_down": _coast_down}
