"""Assembly: drivers loaded by name, instruments connected, clock and operator chosen as the bench file says."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal, Union

from pydantic import BaseModel, Discriminator, create_model

from rig.bench.benchfile import BenchDescription, BenchFile, Role, filled
from rig.bench.clock import SystemClock
from rig.bench.control import BenchClock, BenchOperator, Control, ensure_served
from rig.bench.guard import Charge, load_driver
from rig.bench.operators import AnswersOperator, TerminalOperator
from rig.bench.roles import Energises, Instrument
from rig.errors import BadInput, ConfigError, Problem
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
def connected(
    description: BenchDescription,
    runs: Path,
    roles: Callable[[str], bool] = lambda role: True,
    *,
    transcript: Transcript | None = None,
    hidden_seed: int | None = None,
) -> Iterator[Bench]:
    """The bench with the instruments whose role is wanted; nothing on them is changed. Closed on leaving.

    A simulated bench is started on demand and keeps its world in `.bench/` under the runs folder.
    """
    wanted = {role: fitting for role, fitting in fittings(description).items() if roles(role)}
    with ExitStack() as stack:
        addresses: Mapping[str, object] = {}
        control = None
        if description.simulated:
            addresses = start_simulated(description, runs, hidden_seed)
            control = stack.enter_context(Control(int(str(addresses["control"]))))
        room = _room(description, control, transcript or NoTranscript())
        bench = Bench(description, room, control)
        for role, fitting in wanted.items():
            settings = fitting.module.Settings.model_validate(
                filled(fitting.settings.model_dump(mode="json", exclude={"driver"}), addresses)
            )
            instrument = fitting.module.connect(role, settings, room)
            stack.callback(instrument.close)
            bench.instruments[role] = instrument
            if isinstance(instrument, Energises):
                bench.charges.append(Charge(fitting.driver, role, settings.model_dump(mode="json")))
        yield bench


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
