"""Assembly: drivers loaded by name, instruments connected, clock and operator chosen as the bench file says."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal, Union

from pydantic import BaseModel, Discriminator, create_model

from rig.bench.armed import Armed, left_armed
from rig.bench.benchfile import BenchDescription, BenchFile, Role, filled
from rig.bench.clock import SystemClock
from rig.bench.control import BenchClock, BenchOperator, Control, ensure_served
from rig.bench.guard import PATIENCE, Charge, load_driver
from rig.bench.operators import AnswersOperator, TerminalOperator
from rig.bench.possession import Possession, possessed
from rig.bench.roles import Energises, Instrument
from rig.bench.watched import MARGIN, Heartbeat, watched
from rig.errors import BadInput, ConfigError, NotSafe, Problem
from rig.room import NoTranscript, Room, Transcript
from rig.yaml import config
from rig.yaml.document import Document, read


@dataclass(frozen=True)
class Fitting:
    """One instrument of the bench file: its driver and its validated settings."""

    role: str
    driver: str
    module: ModuleType
    settings: Any


@dataclass
class Bench:
    """Connected instruments by role, and the room that they stand in."""

    description: BenchDescription
    room: Room
    control: Control | None
    instruments: dict[str, Instrument] = field(default_factory=dict)
    charges: list[Charge] = field(default_factory=list)
    possession: Possession | None = None
    simulated_in: str = ""  # the folder of runs that a simulated bench belongs to

    def armed(self, log: Path) -> Armed | None:
        """What is going to be armed, for the guard that writes into `log`; None on a bench that needs no lock."""
        if self.possession is None:
            return None
        names = [charge.name for charge in self.charges]
        return Armed.of(self.possession, names, log, self.simulated_in)


def fittings(description: BenchDescription) -> dict[str, Fitting]:
    """Every instrument's driver and settings; raises ConfigError with all mistakes at their places."""
    document = read(description.path)
    found: dict[str, Fitting] = {}
    problems: list[Problem] = []
    for role in description.file.instruments:
        fitting, wrong = _fitting(document, role, description.file.instruments[role])
        problems += wrong
        if fitting is not None:
            found[role] = replace(fitting, settings=_named(role, fitting.settings, description))
    if problems:
        raise ConfigError(problems)
    return found


def _named(role: str, settings: Any, description: BenchDescription) -> Any:
    """Settings with the names of a recorder's inputs, as the bench wires them where its entry gives none."""
    if "names" not in type(settings).model_fields or settings.names is not None:
        return settings
    return settings.model_copy(update={"names": description.inputs(role)})


def _fitting(document: Document, role: str, entry: Mapping[str, Any]) -> tuple[Fitting | None, list[Problem]]:
    at = ("instruments", role)
    if "driver" not in entry:
        return None, [document.problem((*at, "driver"), "found nothing, wanted a driver's name such as 'hp89410a'")]
    try:
        module = load_driver(str(entry["driver"]))
        if not hasattr(module, "Settings"):
            raise ImportError(f"found '{entry['driver']}', wanted a driver with Settings and connect")
    except ImportError as error:
        return None, [document.problem((*at, "driver"), str(error))]
    settings, problems = config.check(document, entry_of(str(entry["driver"]), module.Settings), at)
    if settings is None:
        return None, problems
    return Fitting(role, str(entry["driver"]), module, settings), []


def entry_of(driver: str, settings: type[BaseModel]) -> type[BaseModel]:
    """What an instrument's entry in a bench file may hold: the name of its driver, and that one's settings."""
    name: Any = Literal[driver]
    return create_model(f"Entry of {driver}", __base__=settings, __doc__=settings.__doc__, driver=(name, ...))


def file_model() -> type[BenchFile]:
    """A bench file with the keys of every driver of the program; the source of its JSON schema."""
    package = importlib.import_module("drivers")
    modules = {one.name: load_driver(one.name) for one in pkgutil.iter_modules(package.__path__)}
    entries = tuple(entry_of(name, one.Settings) for name, one in modules.items() if hasattr(one, "connect"))
    kinds: Any = Annotated[Union[entries], Discriminator("driver")]  # noqa: UP007 - made at run time
    roles: Any = dict[Role, kinds]
    return create_model("BenchFile", __base__=BenchFile, __doc__=BenchFile.__doc__, instruments=(roles, ...))


@contextmanager
def occupied(description: BenchDescription, runs: Path, *, passing: bool = False) -> Iterator[Possession]:
    """The bench to oneself, before the first byte; see `rig.bench.possession.possessed`.

    Raises BenchHeld if somebody has it, NotSafe if it was left armed, unless `passing` is there to make it safe.
    """
    if description.simulated:  # its addresses change with every start; its folder is what it is known by
        addresses = [str(state_folder(description, runs).resolve())]
    else:
        places = (_place(fitting.settings) for fitting in fittings(description).values())
        addresses = [one for one in places if one is not None] or [str(description.path.resolve())]
    with possessed(description.file.bench, addresses, passing=passing) as possession:
        left = left_armed(possession.armed)
        if left is not None and not passing:
            raise NotSafe(f"{left}; wanted it read back as off, `rig bench safe` does it")
        yield possession


@contextmanager
def connected(
    description: BenchDescription,
    runs: Path,
    roles: Callable[[str], bool] = lambda role: True,
    *,
    transcript: Transcript | None = None,
    hidden_seed: int | None = None,
    possession: Possession | None = None,
    guard: Heartbeat | None = None,
) -> Iterator[Bench]:
    """The bench with the instruments whose role is wanted; nothing on them is changed. Closed on leaving.

    A simulated bench is started on demand and keeps its world in `.bench/` under the runs folder. Whoever has the bench
    already (see `occupied`) hands the `possession` in; else it is had for as long. What is said and waited for is a
    sign of life for the `guard`.
    """
    wanted = {role: fitting for role, fitting in fittings(description).items() if roles(role)}
    with ExitStack() as stack:
        if possession is None:
            possession = stack.enter_context(occupied(description, runs))
        addresses: Mapping[str, object] = {}
        control = None
        if description.simulated:
            addresses = start_simulated(description, runs, hidden_seed)
            control = stack.enter_context(Control(int(str(addresses["control"]))))
        room = _room(description, control, transcript or NoTranscript())
        if guard is not None:
            room = watched(room, guard, _patience(wanted.values()))
        bench = Bench(description, room, control, possession=possession)
        bench.simulated_in = str(runs.resolve()) if description.simulated else ""
        for role, fitting in wanted.items():
            instrument, charge = _connection(fitting, addresses, room)
            stack.callback(instrument.close)
            bench.instruments[role] = instrument
            if isinstance(instrument, Energises):
                bench.charges.append(charge)
        yield bench


def _connection(fitting: Fitting, addresses: Mapping[str, object], room: Room) -> tuple[Instrument, Charge]:
    """An instrument connected, and what the guard would need to connect to it."""
    stated = fitting.settings.model_dump(mode="json", exclude={"driver"})
    settings = fitting.module.Settings.model_validate(filled(stated, addresses))
    instrument: Instrument = fitting.module.connect(fitting.role, settings, room)
    return instrument, Charge(fitting.driver, fitting.role, settings.model_dump(mode="json"))


def _place(settings: Any) -> str | None:
    """Through what bytes reach an instrument; None for one that has no line of its own."""
    for key in ("gateway", "address", "device"):
        if isinstance(found := getattr(settings, key, None), str):
            return found
    return None


def _patience(wanted: Iterable[Fitting]) -> float:
    """How long a live program may be silent, s of real time: the longest that one of its links waits for an answer."""
    waits = [getattr(one.settings, "timeout", 0.0) for one in wanted if _place(one.settings)]
    return max(PATIENCE, MARGIN + max(waits, default=0.0))


def start_simulated(description: BenchDescription, runs: Path, hidden_seed: int | None = None) -> Mapping[str, object]:
    """Addresses of the simulated bench of this bench file, started if it is not running."""
    simulated = description.file.simulated
    if simulated is None:
        raise BadInput(f"{description.path.name}: found a bench of real instruments, wanted a simulated one")
    world = description.beside(simulated.world)
    return ensure_served(world, simulated.seed, state_folder(description, runs), hidden_seed)


def state_folder(description: BenchDescription, runs: Path) -> Path:
    """Where the simulated bench keeps its world."""
    return runs / ".bench" / re.sub(r"[^A-Za-z0-9._-]", "-", description.file.bench)


def _room(description: BenchDescription, control: Control | None, transcript: Transcript) -> Room:
    file = description.file
    if control is None and "bench" in (file.clock, file.operator):
        raise BadInput(f"{description.path.name}: found clock or operator 'bench', wanted a simulated bench for it")
    clock = BenchClock(control) if file.clock == "bench" and control else SystemClock()
    if file.operator == "bench" and control:
        return Room(clock, BenchOperator(control), transcript)
    if file.operator == "terminal":
        return Room(clock, TerminalOperator(clock), transcript)
    return Room(clock, AnswersOperator.load(description.beside(file.operator), clock), transcript)
