"""What every value of a calibration rests on: experiments as one recorder has them, noise at rest, declared limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rig import units
from rig.archive.records import Recorded, experiments
from rig.calibrate import resting
from rig.calibrate.cube_route import SAID, Recorder, noise_by_cube, seen_by
from rig.calibrate.resting import Resting
from rig.sensor import Sensor


@dataclass(frozen=True)
class Alignment:
    """Declared limits: beam and mount angles, rad; radius, m; tilt of the platter, rad, None if it is not declared."""

    beam: float
    mount: float
    radius: float
    declared: bool
    platen: float | None = None


def alignment_of(runs: Sequence[Recorded]) -> Alignment:
    """The widest limits of the runs' bench files; zero and marked as not declared if one of them has none."""
    stated = [records.header["bench_file"].get("alignment") for records in runs]
    if not all(stated):
        return Alignment(0.0, 0.0, 0.0, False)
    beam, mount, radius = (
        max(units.parse(one[name], kind) for one in stated)
        for name, kind in (("beam", "angle"), ("mount", "angle"), ("radius", "length"))
    )
    platens = [one.get("platen") for one in stated]
    platen = max(units.parse(one, "angle") for one in platens) if all(platens) else None
    return Alignment(beam, mount, radius, True, platen)


@dataclass(frozen=True)
class Basis:
    """What every part of a calibration looks up; `runs` are single experiments, those of a sequence taken apart."""

    runs: Sequence[Recorded]
    header: Mapping[str, Any]
    sensor: Sensor
    alignment: Alignment
    noise: Mapping[str, Resting]
    without_noise: Mapping[str, str]
    recorder: Recorder = "converter"

    @property
    def temperature(self) -> tuple[float, float, float] | None:
        return resting.conditions_of(self.runs).get("temperature")

    def flags(self) -> Iterator[str]:
        if self.recorder == "cube":
            yield f"{SAID[self.recorder]}, by a clock of its own"
        if self.recorder == "scope":
            yield f"{SAID[self.recorder]}: values are direct estimates, it kept no record at rest to fit a model to"
        if not self.alignment.declared:
            yield "no `alignment` in the bench file of every run: the budgets contain no misalignment"
        for records in self.runs:
            if records.status != "completed":
                left = "read" if records.status == "damaged" else "measured"
                yield f"{records.name} is {records.status}: not every point of it was {left}"
        yield from resting.lines_said(self.noise)


def basis_of(runs: Sequence[Recorded], header: Mapping[str, Any], recorder: Recorder) -> Basis:
    """What was measured, as the recorder that calibrates has it, with the noise that it saw at rest."""
    sensor = Sensor.of(header)
    poles = {channel.name: channel.bandwidth for channel in sensor.channels}
    done = [seen_by(one, recorder) for records in runs for one in experiments(records)]
    noise_of = noise_by_cube if recorder == "cube" else resting.noise_of
    return Basis(done, header, sensor, alignment_of(runs), *noise_of(done, sensor.names, poles), recorder)
