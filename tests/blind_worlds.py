"""Worlds of the blind test: which there are, what is drawn to be hidden in each, and the runs made in it.

Everything follows from a case's identity, so a study that was interrupted goes on with the same worlds. What is hidden
is written to a file of its own before anything is diagnosed; its digest goes with the result.
"""

from __future__ import annotations

import hashlib
import json
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import blind_imports
import blind_strangers
import fast_bench
import numpy as np

from fixtures import drawing, strength
from fixtures.draws import stream
from fixtures.imperfections import Imperfection
from fixtures.physics import Physics
from fixtures.shelf import SHELF
from fixtures.world import World
from rig.foreign.tables import Foreign

MAINS = 50.0
BENCHES = ("shaker", "turntable")
DOCUMENTS: Mapping[str, Mapping[str, Any]] = {
    "shaker": {"procedure": "frequency_sweep", "axis": "x"},
    "turntable": {"procedure": "turntable", "all": True},
}
NAMES: Mapping[str, tuple[str, ...]] = {
    "shaker": (
        "cross_axis", "quadratic", "cubic", "first_order_lag", "resonance", "butterworth_filter", "delay", "rocking",
        "mains_hum", "saturation", "temperature_scale", "supply_ratio", "dead_zone", "hysteresis", "ldv_dropout",
    ),
    "turntable": (
        "asymmetry", "quadratic", "cubic", "g_sensitivity", "lever_arm", "platen_tilt", "encoder_eccentricity",
        "first_order_lag", "warm_up", "temperature_scale", "motor_pickup", "missed_counts",
    ),
}  # fmt: skip
OTHERS: Mapping[str, tuple[str, ...]] = {  # all else that a world can hide and a standard run can show
    bench: tuple(name for name in drawing.names(bench) if name not in named) for bench, named in NAMES.items()
}
OWN = ("clean", "ripple", "one", "two", "others", "unshelved", "strangers", "pairs")
IMPORTED = ("imported_clean", "imported_unknown", "imported_one", "imported_strangers", "faults")
TABLES = (*OWN, *IMPORTED)
PAIRS: Mapping[str, tuple[tuple[str, str], ...]] = {  # that a standard run hardly tells apart, effects.md sections 3, 4
    "shaker": (
        ("delay", "first_order_lag"), ("delay", "butterworth_filter"), ("resonance", "butterworth_filter"),
        ("saturation", "cubic"), ("temperature_scale", "supply_ratio"),
    ),
    "turntable": (
        ("quadratic", "g_sensitivity"), ("encoder_eccentricity", "platen_tilt"), ("platen_tilt", "motor_pickup"),
        ("warm_up", "temperature_bias"), ("lever_arm", "quadratic"),
    ),
}  # fmt: skip
WEAKEST, STRONGEST = drawing.WEAKEST, drawing.STRONGEST
LEAST_STRANGE, LEAST_EASY, LEAST_FAULTY, LEAST_IMPORTED = 20.0, 30.0, 30.0, 10.0
LEAST_CLEAR = 60.0
PAIRED = 3  # number of a delay that is weak
MOST_FAULTY = 300.0
ATTEMPTS = 20
RIPPLE = {"relative": 1e-3}
REMOUNTS = Path(__file__).parents[1] / "procedures" / "remounts.yaml"


@dataclass(frozen=True)
class Case:
    """One world to come: its table, its bench, the names hidden, and its number among such worlds.

    `series` is drawn from afresh when worlds that the program was tuned on must not be used again.
    """

    table: str
    bench: str
    names: tuple[str, ...]
    number: int
    series: str = "1"
    weakest: float = WEAKEST

    @property
    def id(self) -> str:
        return f"{self.series}-{self.table}-{self.bench}-{'+'.join(self.names) or 'nothing'}-{self.number:03d}"

    @property
    def seed(self) -> int:
        return zlib.crc32(self.id.encode()) >> 1


@dataclass(frozen=True)
class Answer:
    """What is hidden in a world: entries with `name`, `parameters` (SI) and the strength `d_prime` that was reached."""

    id: str
    table: str
    bench: str
    seed: int
    hidden: list[dict[str, Any]]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(str(one["name"]) for one in self.hidden)

    @property
    def d_prime(self) -> float:
        """Of the weakest; infinite for a clean world."""
        return min((float(one["d_prime"]) for one in self.hidden), default=math.inf)


def cases(worlds: int, tables: Sequence[str] = TABLES, series: str = "1") -> list[Case]:
    """All worlds of a study, with `worlds` for each effect by name and the other tables in proportion (at 30: 300
    clean, 100 with ripple, 200 with two effects, 10 for each other effect, each off the shelf and each stranger, 60 of
    confounded pairs; of imported records 30 for each effect, stranger and fault of a kind, 120 clean of each kind, and
    150 of those whose noise may be unknown).
    """
    third = max(round(worlds / 3), 1)
    made: dict[str, Iterator[Case]] = {
        "clean": (Case("clean", bench, (), n, series) for bench in BENCHES for n in range(5 * worlds)),
        "ripple": (Case("ripple", "shaker", (), n, series) for n in range(round(worlds * 10 / 3))),
        "one": _each("one", NAMES, worlds, series),
        "two": _pairs(round(worlds * 20 / 3), series),
        "others": _each("others", OTHERS, third, series),
        "unshelved": _each("unshelved", NAMES, third, series),
        "strangers": (
            Case("strangers", bench, (kind.name,), n, series, LEAST_STRANGE)
            for bench, kinds in blind_strangers.KINDS.items() for kind in kinds for n in range(third)
        ),
        "pairs": (
            Case("pairs", bench, (pair[n % 2],), 100 * k + n, series, LEAST_STRANGE)
            for n in range(max(round(worlds / 5), 2)) for bench, pairs in PAIRS.items() for k, pair in enumerate(pairs)
        ),
        "imported_clean": (
            Case("imported_clean", kind, (), n, series) for kind in blind_imports.KINDS for n in range(4 * worlds)
        ),
        "imported_unknown": (
            Case("imported_unknown", kind, (), n, series) for kind in blind_imports.UNKNOWN for n in range(5 * worlds)
        ),
        **{table: _imported(table, worlds, series) for table in ("imported_one", "imported_strangers", "faults")},
    }  # fmt: skip
    return [case for table in tables for case in made[table]]


def _imported(table: str, worlds: int, series: str) -> Iterator[Case]:
    weakest = {"imported_one": LEAST_IMPORTED, "imported_strangers": LEAST_STRANGE, "faults": LEAST_FAULTY}[table]
    for number in range(worlds):
        for kind in blind_imports.KINDS:
            for name in blind_imports.names_of(table, kind):
                yield Case(table, kind, (name,), number, series, weakest)


def _each(table: str, names: Mapping[str, Sequence[str]], count: int, series: str) -> Iterator[Case]:
    for bench in BENCHES:
        for name in names[bench]:
            for number in range(count):
                yield Case(table, bench, (name,), number, series)


def _pairs(count: int, series: str) -> Iterator[Case]:
    for number in range(count):
        bench = BENCHES[number % 2]
        chosen = stream(number, "pair", series).choice(len(NAMES[bench]), 2, replace=False)
        yield Case("two", bench, tuple(NAMES[bench][k] for k in chosen.tolist()), number, series)


def slice_of_all() -> list[Case]:
    """Worlds that the test suite looks at: clean ones, and effects that are easily strong enough to be named.

    Most are of the shaker, whose runs take less time to simulate.
    """
    clean = [Case("clean", "shaker", (), n, "slice") for n in range(2)] + [Case("clean", "turntable", (), 0, "slice")]
    names = [("shaker", name) for name in NAMES["shaker"]]
    names += [("turntable", name) for name in ("asymmetry", "encoder_eccentricity", "platen_tilt", "warm_up")]
    return clean + [Case("one", bench, (name,), 0, "slice", LEAST_EASY) for bench, name in names]


KINDS_OF_THE_SLICE = (  # table, bench, what is hidden, number
    ("imported_clean", "rotation", "", 0), ("imported_clean", "sweep", "", 0), ("imported_clean", "response", "", 0),
    ("imported_unknown", "motion", "", 0), ("imported_one", "rotation", "encoder_eccentricity", 0),
    ("imported_one", "motion", "lever_arm", 0), ("imported_one", "response", "delay", PAIRED),
    ("imported_strangers", "motion", "root_bias", 0), ("faults", "rotation", "glitch", 0),
    ("faults", "sweep", "stuck", 0), ("faults", "poses", "clipping", 0), ("others", "shaker", "spur", 0),
)  # fmt: skip


def slice_of_kinds() -> list[Case]:
    """One world of nearly every other kind that the tables have, strong enough to be told; a delay that looks like a
    lag is a confounded pair.
    """
    return [
        Case(table, bench, (name,) if name else (), number, "slice", LEAST_FAULTY if number else LEAST_CLEAR)
        for table, bench, name, number in KINDS_OF_THE_SLICE
    ]


def drawn(case: Case) -> Answer:
    """What is hidden in a case's world, of a strength that is log-uniform in its range as far as physics allows.

    A world in which it cannot be seen whatever its size (the supply hardly drifts there) is left for another one.
    """
    answer = _drawn(case, case.seed)
    for attempt in range(1, ATTEMPTS):
        if answer.d_prime > 0.9 * case.weakest:
            break
        answer = _drawn(case, zlib.crc32(f"{case.id} {attempt}".encode()) >> 1)
    return answer


def _drawn(case: Case, seed: int) -> Answer:
    random = stream(seed, "blind")
    if case.table in IMPORTED:
        share, record = float(random.uniform()), blind_imports.Record(case.bench, seed)
        return Answer(case.id, case.table, case.bench, seed, [_in_record(case, record, share) for _ in case.names])
    measure = strength.meter(seed, MAINS, case.bench) if case.names else None
    hidden = [_entry(case, name, random, measure) for name in case.names if measure is not None]
    return Answer(case.id, case.table, case.bench, seed, hidden)


def _in_record(case: Case, record: blind_imports.Record, share: float) -> dict[str, Any]:
    """What is hidden in an imported record, or planted there."""
    (name,) = case.names
    if case.table == "faults":
        wanted = _between(case.weakest, MOST_FAULTY, share)
        try:
            _, entry = blind_imports.with_fault(record, name, wanted)
        except ValueError:  # not in this record
            return {"name": name, "parameters": {}, "d_prime": 0.0}
        return {"name": name, "parameters": {}, **entry, "wanted": wanted}
    return blind_imports.hidden(record, name, share, (case.weakest, STRONGEST))


def _entry(
    case: Case, name: str, random: np.random.Generator, measure: strength.Sweep | strength.Turns
) -> dict[str, Any]:
    share = float(random.uniform())
    if case.table == "strangers":
        stranger, wanted = blind_strangers.kind_of(name), _between(case.weakest, STRONGEST, share)
        parameters = blind_strangers.sized(stranger, stranger.drawn(random, case.bench), wanted, measure)
        return {"name": name, "parameters": parameters, "d_prime": measure.strength((stranger(**parameters),))}
    kind = SHELF.kind(name)
    parameters = kind.drawn(random, case.bench)
    most = min(drawing.reach(name, parameters, measure), STRONGEST)
    wanted = _between(min(case.weakest, most), most, share)
    parameters = drawing.sized(name, parameters, wanted, measure)
    return {"name": name, "parameters": parameters, "d_prime": measure.strength((kind(**parameters),))}


def _between(low: float, high: float, share: float) -> float:
    """This share of the way, on a logarithmic scale."""
    return low * (high / low) ** share


def world_of(answer: Answer) -> World:
    """The world with this in it, just begun."""
    extra: list[Imperfection] = []
    if answer.table == "ripple":
        extra.append(blind_strangers.Ripple(**RIPPLE))
    if answer.table == "strangers":
        extra += [blind_strangers.kind_of(str(one["name"]))(**one["parameters"]) for one in answer.hidden]
        return with_more(fast_bench.world(answer.seed), extra)
    entries = [{"name": one["name"], "parameters": one["parameters"]} for one in answer.hidden]
    return with_more(fast_bench.world(answer.seed, entries), extra)


def imported(answer: Answer) -> Foreign:
    """The record with this in it, as somebody would hand it in."""
    known = answer.table != "imported_unknown"
    record = blind_imports.Record(answer.bench, answer.seed, known=known)
    if not answer.hidden:
        return record.made()
    (entry,) = answer.hidden
    if answer.table == "faults":
        return blind_imports.with_fault(record, str(entry["kind"]), float(entry["wanted"]))[0]
    return blind_imports.replace(
        record, law=blind_imports.blind_laws.law_of(str(entry["name"])), at=entry["parameters"]
    ).made()


def with_more(world: World, extra: Sequence[Imperfection]) -> World:
    """The same world with imperfections of no shelf as well; it must not have been used yet."""
    if extra:
        world.imperfections = (*world.imperfections, *extra)
        world.physics = Physics(world.seed, world.mains, world.imperfections)
    return world


def measured(world: World, bench: str) -> fast_bench.MemoryRecords:
    """The standard run of a bench; the world goes on, so the next one is another."""
    return fast_bench.measure(DOCUMENTS[bench], world)


def remounted(world: World) -> fast_bench.MemoryRecords:
    """The run of remounts from which the bench's own floor is measured."""
    return fast_bench.measure(REMOUNTS.read_text(encoding="utf-8"), world)


def first_record(records: fast_bench.MemoryRecords, world: World) -> float:
    """When the first record of a run began, s since the world's start."""
    return min(float(meta["start"]) for meta in records.metas.values() if "convert_period" in meta) - world.epoch


def write(path: Path, body: Mapping[str, Any]) -> str:
    """Write JSON as a whole or not at all; gives the digest of what was written."""
    text = json.dumps(body, indent=1, sort_keys=True, default=_plain)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
    return hashlib.sha256(text.encode()).hexdigest()


def seal(answer: Answer, folder: Path) -> str:
    """Put an answer away; gives its digest."""
    return write(folder / "answers" / f"{answer.id}.json", asdict(answer))


def unsealed(path: Path) -> tuple[Answer, str]:
    """An answer and its digest."""
    text = path.read_text(encoding="utf-8")
    return Answer(**json.loads(text)), hashlib.sha256(text.encode()).hexdigest()


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"found {type(value).__name__}, wanted a number or a text")
