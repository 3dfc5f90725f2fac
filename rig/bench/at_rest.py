"""At rest: static records, waits and what the operator does between them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rig.bench import at_shaker
from rig.bench.station import Station, samples_meta
from rig.bench.steps import Ask, Static, Wait
from rig.record import CubeSamples

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
    with_cube = "cube" in station.description.file.recorders and "cube" in station.instruments
    if with_cube:
        station.cube.configure()
        station.cube.start()
    if station.keeps("recorder") or step.cables == "turntable":
        body |= _converter(step, station, name)
    if with_cube:
        body |= store_cube(station, name, station.cube.read(step.seconds))
        station.cube.stop()
    return body


def _converter(step: Static, station: Station, name: str) -> dict[str, Any]:
    timing = station.recorder.configure(rate=station.description.file.rate, channels=station.channels())
    scans = math.ceil(step.seconds * timing.scan_rate - 1e-9)
    station.recorder.start(scans)
    taken, stream, sums, start = 0, None, np.zeros(2), 0.0
    while taken < scans:
        station.guard.beat(within=30.0)
        with station.watch("instruments"):
            samples = station.recorder.read(min(scans - taken, math.ceil(CHUNK * timing.scan_rate)))
        with station.watch("storage"):
            if stream is None:
                stream, start = station.journal.block_stream(name, samples_meta(samples)), samples.start
            stream.append(samples.counts)
        found = station.conditions(samples)
        sums += np.array([found.get("supply", math.nan), found.get("temperature", math.nan)]) * len(samples.counts)
        taken += len(samples.counts)
        station.progress(f"{step.label} {taken / timing.scan_rate:.0f} of {step.seconds:.0f} s")
    if stream is not None:
        with station.watch("storage"):
            stream.close()
    supply, temperature = (sums / max(taken, 1)).tolist()
    return {
        "samples": name,
        "scans": taken,
        "start": start,
        "conditions": {"supply": supply, "temperature": temperature},
    }


def store_cube(station: Station, name: str, samples: CubeSamples) -> dict[str, Any]:
    """The cube's own frames as two blocks: raw counts, and what came with each frame."""
    meta = {
        "kind": "cube",
        "names": list(samples.names),
        "rate": samples.rate,
        "start": samples.start,
        "gaps": samples.gaps,
        "bad_frames": samples.bad_frames,
    }
    if samples.clock is not None:
        fit = samples.clock
        meta["clock"] = {
            "offset": fit.offset,
            "rate_error": fit.rate_error,
            "u_offset": fit.u_offset,
            "u_rate": fit.u_rate,
        }
    frames = np.column_stack(
        [samples.sequence, samples.device_us, samples.flags, samples.supply, samples.temperature]
    ).astype(np.int64)
    with station.watch("storage"):
        station.journal.block(f"{name}-cube", samples.counts, meta)
        columns = ["sequence", "device_us", "flags", "supply", "temperature"]
        station.journal.block(f"{name}-cube-frames", frames, {"kind": "cube_frames", "columns": columns})
    return {"cube": f"{name}-cube", "cube_gaps": samples.gaps, "cube_bad_frames": samples.bad_frames}
