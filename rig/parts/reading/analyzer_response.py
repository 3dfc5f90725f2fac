"""What the analyzer measured at each sine: the sensor's output over the vibrometer's, as a response to acceleration.

    H(f) = R(f) · D(f)·G/scale ÷ (jω),     u²(H)/|H|² = (1 − γ²)/(2·n·γ²)

R is input 2 ÷ input 1 in the line at the driven frequency, with coherence γ² and n averages (H1 estimate; Bendat and
Piersol, "Random Data", 9.2). Both inputs pass the same window, so a sine beside the middle of a line shows the same R.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rig.archive.records import Recorded
from rig.parts.reading.vibration import COHERENT, Chain
from rig.record import Response
from rig.sensor import Sensor


@dataclass(frozen=True)
class Answer:
    """One sine of one channel: `response` V/(m/s²), `peak` of the acceleration m/s²; `flags` say why it is left out."""

    run: str
    index: int
    channel: str
    level: str
    frequency: float
    peak: float
    response: complex
    coherence: float
    averages: int
    flags: tuple[str, ...] = ()

    @property
    def u_relative(self) -> float:
        """Standard uncertainty of each part of the response, relative to its magnitude, by its own coherence."""
        return (
            math.sqrt((1.0 - self.coherence) / (2.0 * self.averages * self.coherence)) if self.coherence else math.inf
        )

    @property
    def noise(self) -> float:
        """Power of what is not coherent with the reference, V², free of the bias of n averages."""
        free = self.averages / (self.averages - 1.0)
        return free * (1.0 - self.coherence) / self.coherence * (abs(self.response) * self.peak) ** 2


def answers(records: Recorded, chain: Chain, sensor: Sensor) -> list[Answer]:
    """Every response of a sweep to the channel that input 2 was plugged to; [] where the analyzer kept nothing."""
    plugged = _plugged(records)
    return [
        _answer(records, index, body, chain, plugged[index])
        for index, body in sorted(records.points.items())
        if "frequency" in body and "response" in body and plugged.get(index) in sensor
    ]


def _plugged(records: Recorded) -> dict[int, str]:
    """The signal on input 2 at each point, as the operator confirmed it."""
    cables = records.header["bench_file"]["cables"].get("shaker", ())
    signal, found = "", {}
    for entry in records.lines:
        if entry.kind == "confirmed" and entry.body["action"] == "plug_analyzer":
            said = entry.body["settings"]
            # runs of before named the channel and not its place
            signal = str(cables[int(said["slot"])] if "slot" in said else said["signal"])
        elif entry.kind == "point" and signal:
            found[int(entry.body["index"])] = signal
    return found


def _answer(records: Recorded, index: int, body: Mapping[str, object], chain: Chain, channel: str) -> Answer:
    measured = records.response(str(body["response"]))
    frequency, scale = float(str(body["frequency"])), float(str(body["scale"]))
    line = int(np.argmin(np.abs(measured.frequency - frequency)))
    velocity = complex(chain.velocity_per_volt(scale, np.array([frequency]))[0])
    coherence = 0.0 if measured.coherence is None else float(measured.coherence[line])
    return Answer(
        run=records.name,
        index=index,
        channel=channel,
        level=str(body["level"]),
        frequency=frequency,
        peak=float(str(body["acceleration"])),
        response=complex(measured.ratio[line]) / (2j * math.pi * frequency * velocity),
        coherence=coherence,
        averages=measured.averages,
        flags=tuple(_flags(measured, frequency, coherence)),
    )


def _flags(measured: Response, frequency: float, coherence: float) -> list[str]:
    found = [f"{name} over range" for name in measured.overloads]
    if measured.averages < 2:
        found.append("one average: its coherence says nothing")
    if not coherence >= COHERENT:
        found.append(f"low coherence ({coherence:.3f})")
    if frequency > float(measured.frequency[-1]):
        found.append(f"beyond the span of {measured.frequency[-1]:g} Hz")
    return found
