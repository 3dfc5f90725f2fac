"""The runner: carries a plan out step by step, keeps the journal, and leaves the bench at rest whatever happens."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rig.archive.guard_log import GUARD_LOG, GuardLog
from rig.archive.runs import Run, Runs
from rig.archive.writer import RunWriter
from rig.bench import at_rest, at_shaker, at_turntable, resuming
from rig.bench.assembly import Bench, connected, occupied
from rig.bench.benchfile import BenchDescription
from rig.bench.guard import Guard
from rig.bench.roles import Energises
from rig.bench.station import Drive, Station, Stopwatch
from rig.bench.steps import AlignBeam, Ask, Plan, SetFilter, Sine, Spin, Static, Step, Wait
from rig.bench.stopping import stoppable, uninterrupted
from rig.bench.transcript import RunTranscript
from rig.errors import BadInput, InstrumentError, NotSafe, RigError, VerdictNotMet, WorkFailed
from rig.yaml import config

PATIENCE = 60.0  # s of real time that one step of a few seconds may take before the guard calls it hung
STEADY_SETTINGS = frozenset(
    {"mode", "start", "stop", "points", "averages", "window", "input_1_coupling", "input_2_coupling", "duration"}
    | {"first", "last", "gain", "convert_period", "decoder", "full_scale"}
)
RESUME_TOLERANCE = 0.02  # the repeated point must give the same ratio of motion to drive within this


@dataclass(frozen=True)
class Progress:
    """Where a run is: steps done of all, and the bench time that the rest will take, s."""

    done: int
    total: int
    points_done: int
    points: int
    label: str
    remaining: float


@dataclass(frozen=True)
class Outcome:
    """How a run ended, and where real time went (s)."""

    name: str
    status: str
    elapsed: float
    shares: Mapping[str, float]


@dataclass(frozen=True)
class Order:
    """Everything that a run is made from. `document` is the procedure as it was written, for resuming."""

    plan: Plan
    document: Mapping[str, Any]
    description: BenchDescription
    runs: Path
    label: str
    allow_overdue: bool = False
    on_progress: Callable[[Progress], None] = field(default=lambda progress: None)


def run(order: Order) -> Outcome:
    """Carry out a plan as a new run. Errors pass through after the bench is at rest; the run is then `interrupted`.

    Raises what the steps raise; VerdictNotMet also closes the run as `aborted`.
    """
    with _attended(order) as (guard, bench, transcript):
        overdue = _refuse_beforehand(order, bench)
        runs = Runs(order.runs, now=bench.room.clock.now)
        with runs.create(order.plan.procedure, _header(order, bench, overdue), order.label) as writer:
            transcript.attach(writer.path)
            return _Carrying(order, bench, guard, writer).carry_out(done=frozenset())


def resume(order: Order, name: str) -> Outcome:
    """Go on with an interrupted run: same instruments and settings, what may be repeated, then the rest.

    Raises BadInput if the bench is not that of the run, VerdictNotMet if the repeated point differs.
    """
    with _attended(order) as (guard, bench, transcript):
        _refuse_beforehand(order, bench)
        runs = Runs(order.runs, now=bench.room.clock.now)
        old = runs.open(name)
        _refuse_other_bench(old.header, bench)
        steps = {int(e.body["index"]): e.body for e in old.lines() if e.kind in ("step", "point")}
        with runs.reopen(name) as writer:
            transcript.attach(writer.path)
            _journal_the_guard(writer, old)
            carrying = _Carrying(order, bench, guard, writer)
            carrying.expected = {e.body["role"]: e.body["settings"] for e in old.lines() if e.kind == "settings"}
            return carrying.carry_out(done=frozenset(steps), recorded=steps)


def _journal_the_guard(writer: RunWriter, old: Run) -> None:
    """What the guard did when nobody could write the journal any more."""
    known = sum(len(entry.body["events"]) for entry in old.lines() if entry.kind == "guard")
    if events := GuardLog(old.path / GUARD_LOG).events()[known:]:
        writer.note("guard", events=events)


@contextmanager
def _attended(order: Order) -> Iterator[tuple[Guard, Bench, RunTranscript]]:
    """The bench to oneself, the guard beside us, the instruments connected, and every exchange written down.

    Undone in the other order. An error that then leaves says how the bench was left; NotSafe takes its place if what
    was energised was not read back as off.
    """
    with stoppable(), occupied(order.description, order.runs) as possession:
        guard, transcript = Guard.start(possession.descriptors), RunTranscript()
        ready = connected(
            order.description, order.runs, _needed(order), transcript=transcript, possession=possession, guard=guard
        )
        try:
            with guard, closing(transcript), ready as bench:
                yield guard, bench, transcript
        except BaseException as error:
            left = _left(guard, error)
            if not left and not getattr(error, "__notes__", ()) and not isinstance(error, RigError):
                left = "nothing was energised"
            if left:
                error.add_note(left)
            raise


def _left(guard: Guard, error: BaseException) -> str:
    try:
        return guard.how_left()
    except NotSafe as unsafe:
        raise unsafe from error


def _needed(order: Order) -> Callable[[str], bool]:
    """Which roles a plan needs: a turntable run leaves the shaker's instruments alone, and the other way round."""
    kinds = {type(step) for step in order.plan.steps}
    needed: set[str] = {"recorder"}
    if kinds & {Sine, AlignBeam}:
        needed |= {"analyzer", "vibrometer", "filter", "scope"}
    if kinds & {SetFilter}:
        needed |= {"analyzer", "filter"}
    if Spin in kinds:
        needed |= {"turntable", "encoder"}
    if "cube" in order.description.file.recorders:
        needed |= {"cube"}
    if "scope" not in order.description.file.recorders:
        needed -= {"scope"}
    return lambda role: role in needed


def _refuse_beforehand(order: Order, bench: Bench) -> list[str]:
    """Everything that can be refused before anything is energised; returns overdue standards that were overridden."""
    overdue = order.description.refuse_overdue(bench.room.clock.now(), order.allow_overdue)
    check = getattr(bench.room.operator, "check", None)
    if check is not None:
        check(order.plan.requests)
    return overdue


def _header(order: Order, bench: Bench, overdue: list[str]) -> dict[str, Any]:
    """What the run is: everything needed to understand its records years later."""
    description, plan = order.description, order.plan
    return {
        "title": plan.title,
        "settings": plan.settings,
        "document": order.document,
        "steps": [{"kind": type(s).__name__, "label": s.label, "point": s.point} for s in plan.steps],
        "experiments": [asdict(one) for one in plan.experiments],
        "points_total": plan.points,
        "expect": {name: list(limits) for name, limits in plan.expect.items()},
        "simulated": description.simulated,
        "bench": description.file.bench,
        "bench_file": description.file.model_dump(mode="json"),
        "sensor": description.sensor.model_dump(mode="json"),
        "standards": [standard.model_dump(mode="json") for standard in description.standards],
        "overdue_overridden": overdue,
        "identities": identities(bench),
        "program": config.program_version(),
        "started": bench.room.clock.now(),
    }


def identities(bench: Bench) -> dict[str, dict[str, str]]:
    """Every connected instrument's identity; raises WrongIdentity."""
    return {role: asdict(instrument.identify()) for role, instrument in bench.instruments.items()}


def _refuse_other_bench(header: Mapping[str, Any], bench: Bench) -> None:
    now = identities(bench)
    for role, identity in header["identities"].items():
        if now.get(role) != identity:
            raise BadInput(f"{role}: found {now.get(role)}, wanted the instrument of the run: {identity}")
    file = bench.description.file.model_dump(mode="json")
    for key, value in header["bench_file"].items():
        if file.get(key) != value:
            raise BadInput(f"bench file, {key}: found {file.get(key)}, wanted as in the run: {value}")


class _Carrying:
    """One plan being carried out."""

    def __init__(self, order: Order, bench: Bench, guard: Guard, writer: RunWriter) -> None:
        self._order, self._bench, self._guard, self._writer = order, bench, guard, writer
        self._done = 0
        self.expected: dict[str, Mapping[str, Any]] = {}  # settings that a resumed run must find again
        self._watch = Stopwatch()
        self._station = Station(
            order.description,
            bench.instruments,
            bench.room,
            writer,
            guard,
            self._watch,
            self._report,
            Drive(order.description.file.shaker.displacement_per_volt),
        )

    def carry_out(self, done: frozenset[int], recorded: Mapping[int, Mapping[str, Any]] | None = None) -> Outcome:
        """Every step that is not done; the bench is at rest when this returns or raises."""
        begun, cost = time.perf_counter(), self._simulation()
        log = self._writer.path / GUARD_LOG
        self._guard.arm(self._bench.charges, within=PATIENCE, log=log, armed=self._bench.armed(log))
        try:
            if recorded:
                self._station.cables = resuming.cables_of(self._order.plan.steps, done)
                self._station.drive.constants |= resuming.drive_constants(recorded)
            self._prepare()
            if recorded:
                self._begin_again(recorded)
            for index, step in enumerate(self._order.plan.steps):
                self._done = index
                if index not in done:
                    self._one(index, step)
            self._done = len(self._order.plan.steps)
        except VerdictNotMet as verdict:
            self._end("aborted", verdict)
            raise
        except BaseException as error:
            self._end(None, error)
            raise
        self._end("completed", None)
        elapsed = time.perf_counter() - begun
        return Outcome(self._writer.name, "completed", elapsed, self._shares(elapsed, self._simulation() - cost))

    def _one(self, index: int, step: Step) -> None:
        self._guard.beat(within=PATIENCE + step.duration)
        self._report(step.label)
        self._station.step = f"{index:04d}"
        body = {"label": step.label, **carry_out_step(step, self._station)}
        with self._watch("storage"):
            if step.point:
                self._writer.point_done(index, body)
            else:
                self._writer.note("step", index=index, **body)

    def _prepare(self) -> None:
        """Bring the instruments into the state that the steps expect, and write down what they read back."""
        if any(isinstance(step, Sine) for step in self._order.plan.steps):
            at_shaker.prepare(self._station)
        if "recorder" in self._bench.instruments:
            self._station.wire()
        for role, instrument in self._bench.instruments.items():
            settings = instrument.settings()
            self._writer.note("settings", role=role, settings=settings)
            self._refuse_other_settings(role, settings)

    def _refuse_other_settings(self, role: str, settings: Mapping[str, Any]) -> None:
        """What does not move during a run must read back as it did when the run began."""
        for key in STEADY_SETTINGS & settings.keys() & self.expected.get(role, {}).keys():
            if settings[key] != self.expected[role][key]:
                raise BadInput(
                    f"{role}, {key}: found {settings[key]}, wanted {self.expected[role][key]} as the run began"
                )

    def _begin_again(self, recorded: Mapping[int, Mapping[str, Any]]) -> None:
        """What the bench allows to repeat: of a sine, the ratio of motion to drive must be what it was."""
        one = resuming.again(self._order.plan.steps, recorded.keys())
        if one is None:
            return
        self._guard.beat(within=PATIENCE + one.step.duration)
        self._report(one.step.label)
        self._station.step = f"{one.index:04d}-{one.kind}"
        body = carry_out_step(one.step, self._station)
        if not isinstance(one.step, Sine):
            self._writer.note(one.kind, index=one.index, **body)
            return
        was, now = float(recorded[one.index]["drive_constant"]), float(body["drive_constant"])
        self._writer.note(one.kind, index=one.index, was=was, now=now, **body)
        if abs(now / was - 1.0) > RESUME_TOLERANCE:
            raise VerdictNotMet(
                f"{one.step.label}, repeated: found {now / was - 1.0:+.2%} in motion per drive, "
                f"wanted within {RESUME_TOLERANCE:.0%} of the point before the interruption"
            )

    def _end(self, status: str | None, error: BaseException | None) -> None:
        """The safe action first, then the seal. Without confirmation of the safe action the guard stays armed."""
        try:
            failed = self._make_safe()
        except WorkFailed as gone:  # the guard had acted; what was measured meanwhile is not a completed run
            failed = None
            if error is None:
                raise
            self._writer.note("guard_gone", reason=str(gone))
        if failed is not None:
            self._writer.note("not_safe", reason=str(failed), left_to="the guard")
            if error is None:
                raise failed
        if error is not None:
            self._say_of_the_platter(error)
            self._writer.note("stopped", error=type(error).__name__, reason=str(error))
        if status == "completed":
            self._writer.seal("completed")
        elif status == "aborted":
            self._writer.seal("aborted", str(error))

    def _make_safe(self) -> InstrumentError | None:
        """Every instrument that energises something off and read back; the failure if one of them was not."""
        failed = None
        with uninterrupted():
            self._guard.leave()
            for instrument in self._bench.instruments.values():
                if isinstance(instrument, Energises):
                    try:
                        instrument.make_safe()
                    except InstrumentError as unsafe:
                        failed = failed or unsafe
            if failed is None:
                self._guard.disarm()
        return failed

    def _say_of_the_platter(self, error: BaseException) -> None:
        """Nobody but a person can stop it, and only its encoder can say that it stands."""
        said = {"turning": "platter: not confirmed", "standing": "platter: at rest, by its encoder", "untouched": ""}
        if text := said[self._station.platter]:
            error.add_note(text)

    def _report(self, label: str) -> None:
        steps = self._order.plan.steps
        self._order.on_progress(
            Progress(
                self._done,
                len(steps),
                sum(step.point for step in steps[: self._done]),
                self._order.plan.points,
                label,
                sum(step.duration for step in steps[self._done :]),
            )
        )

    def _simulation(self) -> float:
        return float(self._bench.control.ask("cost")["simulation_s"]) if self._bench.control else 0.0

    def _shares(self, elapsed: float, simulation: float) -> dict[str, float]:
        spent = self._watch.seconds
        wire = max(spent["instruments"] - simulation, 0.0)
        rest = elapsed - wire - simulation - spent["storage"] - spent["analysis"]
        return {
            "wire": wire,
            "simulation": simulation,
            "storage": spent["storage"],
            "analysis": spent["analysis"],
            "other": max(rest, 0.0),
        }


def carry_out_step(step: Step, station: Station) -> dict[str, Any]:
    """Do one step and say what there is to say about it."""
    match step:
        case Sine():
            return at_shaker.sine(step, station)
        case Static():
            return at_rest.static(step, station)
        case Spin():
            return at_turntable.spin(step, station)
        case SetFilter():
            body = at_shaker.set_filter(step, station)
            at_shaker.prepare(station)
            return body
        case AlignBeam():
            return at_shaker.align(step, station)
        case Ask():
            return at_rest.ask(step, station)
        case Wait():
            return at_rest.wait(step, station)
    raise WorkFailed(f"found a step of kind {type(step).__name__}, wanted one that the bench knows")
