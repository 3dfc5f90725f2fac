"""Steps: what a procedure turns its settings into, and all that a bench is ever asked to do.

A procedure is data before it is a movement: one flat tuple of these frozen values gives the dry run, the duration,
the limits, the run, the resume and the report. Everything is SI.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from rig.room import Request

Axis = Literal["x", "y", "z"]
Hold = Literal["acceleration", "velocity", "drive"]


@dataclass(frozen=True)
class Step:
    """One thing the bench does. `duration` (s, bench clock) is an estimate; `point` says whether it is counted."""

    label: str
    duration: float = 0.0
    point: bool = False


@dataclass(frozen=True)
class Ask(Step):
    """The operator does one thing and confirms it."""

    request: Request = field(default_factory=lambda: Request("confirm", ""))


@dataclass(frozen=True)
class Wait(Step):
    """Nothing moves for `duration`."""


@dataclass(frozen=True)
class AlignBeam(Step):
    """The operator aligns the laser until the optical level is good."""


@dataclass(frozen=True)
class SetFilter(Step):
    """The operator sets the tunable filter; then it is verified by its measured response."""

    mode: str = "low-pass"
    cutoff: float = 5000.0
    response: str = "butterworth"
    gain_db: float = 0.0
    verify: bool = True


@dataclass(frozen=True)
class Static(Step):
    """A record of `seconds` with nothing driven; `cables` says which cable set the converter is on."""

    seconds: float = 1.0
    cables: str = "shaker"
    purpose: str = "static"
    settle: float = 0.0


@dataclass(frozen=True)
class Sine(Step):
    """One frequency at one level: settle, then record whole cycles.

    `target` is the peak that `hold` names: m/s² for acceleration, m/s for velocity, V (peak, into 50 Ω) for drive.
    `acceleration` is the peak acceleration expected, m/s², whatever is held.
    """

    axis: Axis = "x"
    frequency: float = 0.0
    level: str = "full"
    hold: Hold = "acceleration"
    target: float = 0.0
    acceleration: float = 0.0
    settle: float = 0.3
    scans: int = 3125


@dataclass(frozen=True)
class Spin(Step):
    """One phase of a turntable run, recorded as a whole.

    `phase`: `spin_up` starts the platter at `rpm` and records until it is steady; `hold` records `revolutions`
    whole revolutions; `perturbed` does so with a touch of `fraction`; `coast_down` stops the drive and records until
    the platter rests.
    """

    phase: Literal["spin_up", "hold", "perturbed", "coast_down"] = "hold"
    rpm: float = 45.0
    revolutions: int = 40
    fraction: float = 0.0
    gyro_axis: str = "yaw"
    inverted: bool = False


@dataclass(frozen=True)
class Limits:
    """What the bench may do: peak drive acceleration m/s², stroke m, velocity m/s, source V (peak, into 50 Ω)."""

    acceleration: float
    stroke: float
    velocity: float
    source: float


@dataclass(frozen=True)
class Plug:
    """A channel that the analyzer can be plugged to: as the operator is told, and its place on the shaker cables."""

    channel: str
    title: str
    slot: int


@dataclass(frozen=True)
class BenchFacts:
    """What a procedure may know about the bench before anything is connected.

    `drive_constant`: peak displacement per programmed source volt, m/V (paper eq. 3), nominal. `scan_rate`: Hz per
    channel that the converter gives. `mains` Hz. `full_stroke` m and `full_acceleration` m/s² define the full level.
    `plugs`: for each driven axis the sensor that the analyzer's input 2 should see.
    """

    limits: Limits
    drive_constant: float
    scan_rate: float
    mains: float
    full_stroke: float
    full_acceleration: float
    filter_cutoff: float
    has: frozenset[str]
    plugs: Mapping[str, Plug] = field(default_factory=dict)


@dataclass(frozen=True)
class Mistake:
    """One thing wrong with a procedure's settings, at a key path such as ("stop",) or ("steps", 2, "axis")."""

    path: tuple[str | int, ...]
    text: str


@dataclass(frozen=True)
class Experiment:
    """One procedure within a plan: its steps are those from `first` up to `end`, which is not among them."""

    procedure: str
    title: str
    first: int
    end: int


@dataclass(frozen=True)
class Plan:
    """What will happen: steps in order, and what is expected of the result.

    `expect` holds limits (SI) by the key of a result, such as `unit_a_x.sensitivity`.
    `parts` are the procedures of a sequence; prompts, waits and remounts between them belong to none.
    """

    procedure: str
    title: str
    settings: Mapping[str, object]
    steps: tuple[Step, ...]
    mistakes: tuple[Mistake, ...] = ()
    expect: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    parts: tuple[Experiment, ...] = ()

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """Every procedure of the plan: the parts of a sequence, else the plan itself."""
        return self.parts or (Experiment(self.procedure, self.title, 0, len(self.steps)),)

    @property
    def points(self) -> int:
        return sum(step.point for step in self.steps)

    @property
    def duration(self) -> float:
        """Estimated length on the bench's clock, s."""
        return sum(step.duration for step in self.steps)

    @property
    def requests(self) -> tuple[Request, ...]:
        """Everything the operator will be asked, so that a run nobody attends can refuse beforehand."""
        return tuple(request for step in self.steps for request in requests_of(step))


def requests_of(step: Step) -> tuple[Request, ...]:
    """What one step asks of the operator, in order."""
    match step:
        case Ask(request=request):
            return (request,)
        case AlignBeam():
            return (
                Request("align_beam", "Align the laser beam on the target until the signal level is steady and high."),
            )
        case SetFilter():
            return (
                filter_request(step),
                *((filter_test_request(on=True), filter_test_request(on=False)) if step.verify else ()),
            )
        case Spin(phase="spin_up", rpm=rpm):
            return (speed_request(rpm),)
        case Spin(phase="coast_down"):
            return (speed_request(0.0),)
        case Spin(phase="perturbed", fraction=fraction):
            return (touch_request(fraction),)
        case _:
            return ()


def filter_request(step: SetFilter) -> Request:
    card = f"Set the filter to {step.mode} {step.cutoff:g} Hz, {step.response}, gain {step.gain_db:g} dB."
    return Request(
        "set_filter",
        card,
        {"mode": step.mode, "cutoff": step.cutoff, "response": step.response, "gain_db": step.gain_db},
    )


def filter_test_request(*, on: bool) -> Request:
    card = (
        "Connect the analyzer's source to the filter's input and to analyzer input 1, the filter's output to input 2."
        if on
        else "Restore the cables: LDV through the filter to analyzer input 1, the sensor to input 2."
    )
    return Request("filter_test", card, {"on": on})


def speed_request(rpm: float) -> Request:
    card = f"Start the platter at {rpm:.4g} rpm." if rpm else "Switch the platter's drive off and let it coast to rest."
    return Request("turntable_speed", card, {"rpm": rpm})


def touch_request(fraction: float) -> Request:
    change = "slow" if fraction < 0 else "speed up"
    return Request(
        "touch",
        f"Touch the platter's rim lightly so as to {change} it by about {abs(fraction):.0%} for ten seconds.",
        {"fraction": fraction, "seconds": 10.0},
    )


def cables_request(name: str) -> Request:
    return Request("cables", f"Connect the {name} cable set to the converter.", {"set": name})
