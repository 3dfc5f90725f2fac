"""Scores of the blind test: every table of the study from its answers and results, with binomial intervals.

Intervals are Clopper and Pearson's (1934), 95 %. A world whose diagnosis failed counts as wrong everywhere.
"""

from __future__ import annotations

import itertools
import json
import math
import statistics
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from blind_trials import holds
from blind_worlds import LEAST_FAULTY, Answer, unsealed

BINS = (6.0, 10.0, 30.0, 100.0, 600.0)
LARGEST_CLASS = 3
SURE, STRONG = 0.9, 20.0
OWN = ("shaker", "turntable")  # benches; whatever else a world is of was imported
STATED = (0.0, 0.25, 0.5, 0.75, 0.9, 0.99, 1.0)  # probabilities that are counted together
EVENS = 0.5
POPULATIONS: Mapping[str, tuple[str, ...]] = {
    "one effect of the shelf": ("one", "others", "pairs", "imported_one"),
    "two effects": ("two",),
    "an effect of no shelf": ("strangers", "unshelved", "imported_strangers"),
    "nothing hidden": ("clean", "ripple", "imported_clean", "imported_unknown"),
    "a fault of samples": ("faults",),
}
CONFIDENCE = 0.95
REPAIRED = 1.1  # χ²/n of rows held out
EXPRESSIBLE = (  # strangers whose law a formula of rates, forces, angle and time can be
    "root_bias", "field_bias", "log_gain", "gain_step", "drive_squared",
)  # fmt: skip
FAMILY = (
    "delay", "reference_delay", "first_order_lag", "moving_average", "butterworth_filter", "bessel_filter",
)  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """A world with what was hidden and what was said."""

    answer: Answer
    result: Mapping[str, Any]

    @property
    def table(self) -> str:
        return self.answer.table

    @property
    def exact(self) -> bool:
        """Exactly the hidden effect and nothing else."""
        return self.result["verdict"] == "missing" and sorted(self.result["named"]) == sorted(self.answer.names)

    @property
    def in_first_class(self) -> bool:
        """The first class holds a hidden effect and has at most three members."""
        steps = self.result["steps"]
        members = steps[0]["members"] if steps else []
        return len(members) <= LARGEST_CLASS and bool(set(members) & set(self.answer.names))

    @property
    def all_in_classes(self) -> bool:
        """Every hidden effect is in a named class, and no class is without one."""
        classes = [set(step["members"]) for step in self.result["steps"]]
        hidden = set(self.answer.names)
        held = set[str]().union(*classes) if classes else set[str]()
        return self.result["verdict"] == "missing" and hidden <= held and all(one & hidden for one in classes)

    @property
    def held(self) -> bool:
        """Some class that was named holds a hidden effect."""
        return any(set(step["members"]) & set(self.answer.names) for step in self.result["steps"])

    @property
    def leaves_more(self) -> bool:
        """What is named leaves more of the held-out χ² than one standard deviation above the noise."""
        kept = self.result.get("held_out")
        return kept is None or kept["chi2"] - kept["true"] > kept["sigma"]

    @property
    def stated(self) -> list[tuple[str, float]]:
        """Every effect that was said to be possible, with the probability that was said of it."""
        found = []
        for step in self.result["steps"]:
            taken = step["probability"]
            if self.result["verdict"] == "unlisted":  # as the program says it
                taken = min(EVENS, taken * min(max(self.result.get("explained", 0.0), 0.0), 1.0))
            found += [(str(name), float(value)) for name, value in step.get("stated", [[step["name"], taken]])]
        return found

    @property
    def wrong_and_sure(self) -> bool:
        """Whether something that is not hidden was named with a probability of at least 0.9."""
        return any(value >= SURE and name not in self.answer.names for name, value in self.stated)

    @property
    def depends_on_band(self) -> bool:
        """Whether something that was taken is marked so."""
        return any(step.get("depends_on_band", False) for step in self.result["steps"])

    @property
    def known(self) -> bool:
        """Whether something else than the misfit told the noise of an imported record."""
        return "misfit" not in self.result.get("origins", ["misfit"])

    @property
    def repaired(self) -> bool:
        """Whether a formula was offered that leaves nothing but noise in the rows held out."""
        found = self.result.get("repaired", {})
        return bool(found.get("formula")) and found["held"] is not None and found["held"] <= REPAIRED

    def is_said(self, verdict: str) -> bool:
        """Whether that was the verdict."""
        return bool(self.result["verdict"] == verdict)

    @property
    def imported(self) -> bool:
        """Whether somebody else's records were diagnosed."""
        return self.answer.bench not in OWN

    @property
    def sure(self) -> bool:
        """Some name has a probability of at least 0.9."""
        return any(step["probability"] >= SURE for step in self.result["steps"])


@dataclass(frozen=True)
class Row:
    """One line of the table: a share of worlds, or a figure, against its bar."""

    what: str
    found: str
    bar: str
    worlds: int


def limits(good: int, of: int) -> tuple[float, float]:
    """Clopper and Pearson's interval of a share."""
    from scipy.stats import binomtest

    low, high = binomtest(good, of).proportion_ci(CONFIDENCE, "exact")
    return float(low), float(high)


def share(good: int, of: int) -> str:
    """A share with its interval in percent."""
    if not of:
        return "no worlds"
    low, high = limits(good, of)
    return f"{good}/{of} = {100 * good / of:.1f} % ({100 * low:.1f}–{100 * high:.1f})"


def trials(folder: Path, kept: str = "results") -> list[Trial]:
    """All results with their answers. Raises ValueError if an answer is not the one that was sealed."""
    found = []
    for path in sorted((folder / kept).glob("*.json")):
        result = json.loads(path.read_text(encoding="utf-8"))
        answer, digest = unsealed(folder / "answers" / path.name)
        if digest != result["sealed"]:
            raise ValueError(f"{path.name}: found another answer than the one sealed before the diagnosis")
        found.append(Trial(answer, result))
    return found


def rows(found: Sequence[Trial]) -> list[Row]:
    """The main table."""
    of = defaultdict(list)
    for one in found:
        of[one.table].append(one)
    makers: dict[str, Callable[[list[Trial]], Iterator[Row]]] = {
        "clean": _clean, "ripple": _ripple, "one": _one, "two": _two, "others": _others, "unshelved": _unshelved,
        "strangers": _strangers, "pairs": _pairs, "imported_clean": _imported_clean,
        "imported_unknown": _imported_unknown, "imported_one": _imported_one, "faults": _faults,
        "imported_strangers": _imported_strangers,
    }  # fmt: skip
    made = [row for table, maker in makers.items() if of[table] for row in maker(of[table])]
    return [*made, *wrong_and_sure(found), *_times(found)]


def _row(what: str, chosen: Iterable[Trial], good: Callable[[Trial], bool], bar: str) -> Row:
    chosen = list(chosen)
    return Row(what, share(sum(map(good, chosen)), len(chosen)), bar, len(chosen))


def _clean(found: list[Trial]) -> Iterator[Row]:
    yield _row("clean: an effect named", found, lambda one: bool(one.result["named"]), "≤ 1 %")
    yield _row("clean: said not to be adequate", found, lambda one: one.result["verdict"] != "adequate", "")


def _ripple(found: list[Trial]) -> Iterator[Row]:
    what = "clean with 0.1 % ripple, floor measured: an effect named"
    yield _row(what, found, lambda one: bool(one.result["named"]), "≤ 3 %")
    yield _row("… said not to be adequate", found, lambda one: one.result["verdict"] != "adequate", "")


def _one(found: list[Trial]) -> Iterator[Row]:
    strong = [one for one in found if one.answer.d_prime >= 10.0]
    yield _row("one effect, d′ ≥ 10: in a first class of ≤ 3", strong, lambda one: one.in_first_class, "≥ 95 %")
    for bench, bar in (("shaker", "≥ 81 %"), ("turntable", "≥ 92 %")):
        here = [one for one in found if one.answer.bench == bench]
        yield _row(f"exactly that effect and nothing else, {bench}", here, lambda one: one.exact, bar)
        for place, (low, high) in enumerate(itertools.pairwise(BINS)):
            inside = [one for one in here if bisect_right(BINS[1:-1], one.answer.d_prime) == place]
            yield _row(f"… d′ {low:g} to {high:g}", inside, lambda one: one.exact, "")
    yield from _fresh(found)
    yield from _intervals(found)


def _fresh(found: Sequence[Trial]) -> Iterator[Row]:
    ratios = sorted(
        one.result["fresh"]["chi2"] / one.result["fresh"]["freedom"] for one in found if "fresh" in one.result
    )
    if ratios:
        ninety = ratios[min(math.ceil(0.9 * len(ratios)), len(ratios)) - 1]
        said = f"median {statistics.median(ratios):.3f}, 90 % below {ninety:.3f}, largest {ratios[-1]:.3g}"
        yield Row("χ² per degree of freedom on a fresh run", said, "≤ 1.03, ≤ 1.10 in 90 %", len(ratios))


def _intervals(found: Sequence[Trial]) -> Iterator[Row]:
    from scipy.stats import binom

    for least, what in ((0.0, "truth inside the 95 % interval"), (30.0, "… d′ ≥ 30")):
        strong = [one for one in found if one.answer.d_prime >= least]
        checked = [one.result["interval"] for one in strong if "interval" in one.result]
        if checked:
            low, high = binom.interval(0.99, len(checked), 0.95)
            bar = f"{low:.0f} to {high:.0f} of {len(checked)} (99 % band of 95 %)"
            yield Row(what, share(sum(map(holds, checked)), len(checked)), bar, len(checked))


def _two(found: list[Trial]) -> Iterator[Row]:
    yield _row("two effects: both in the named classes, no third", found, lambda one: one.all_in_classes, "≥ 90 %")
    yield _row("… both exactly", found, lambda one: one.exact, "")
    for least in (10.0, 30.0):
        strong = [one for one in found if one.answer.d_prime >= least]
        yield _row(f"… in the classes, both d′ ≥ {least:g}", strong, lambda one: one.all_in_classes, "")


def _others(found: list[Trial]) -> Iterator[Row]:
    yield _row("any other effect, noise among them: exactly that", found, lambda one: one.exact, "")
    yield _row("… in a first class of ≤ 3", found, lambda one: one.in_first_class, "")
    yield _row(
        "… another named, and none of its class", found, lambda one: bool(one.result["named"]) and not one.held, ""
    )
    strong = [one for one in found if one.answer.d_prime >= 10.0]
    yield _row("… d′ ≥ 10, said to be adequate", strong, lambda one: one.result["verdict"] == "adequate", "")


def _unshelved(found: list[Trial]) -> Iterator[Row]:
    strong = [one for one in found if one.answer.d_prime >= 50.0]
    what = "effect off the shelf, d′ ≥ 50: unlisted, or only what leaves the noise"

    def fair(one: Trial) -> bool:
        return bool(one.result["verdict"] == "unlisted") or not one.leaves_more

    yield _row(what, strong, fair, "≥ 90 %")
    yield _row("… all strengths", found, fair, "")
    yield _row("… verdict unlisted, d′ ≥ 50", strong, lambda one: one.result["verdict"] == "unlisted", "")
    wrong = "… probability ≥ 0.9 for a wrong name that leaves more"
    yield _row(wrong, found, lambda one: one.sure and one.leaves_more and one.result["verdict"] == "missing", "≤ 5 %")
    yield _row(
        "… the nearest effects of an unlisted one among them", found, lambda one: one.sure and one.leaves_more, ""
    )


def _strangers(found: list[Trial]) -> Iterator[Row]:
    yield from _unlisted("strangers, d′ ≥ 20: unlisted", found)


def _unlisted(what: str, found: list[Trial]) -> Iterator[Row]:
    """How many are said to be on no shelf, of every kind, and how many the formula that is offered repairs."""
    yield _row(what, found, lambda one: one.is_said("unlisted"), "≥ 97 %")
    for name, here in _by(found, lambda one: f"{one.answer.names[0]}, {one.answer.bench}"):
        yield _row(f"… {name}", here, lambda one: one.is_said("unlisted"), "")
    able = [one for one in found if one.answer.names[0] in EXPRESSIBLE]
    what = "… those that a formula can express: held-out χ²/n with the formula offered ≤ 1.1"
    yield _row(what, able, lambda one: one.repaired, "≥ 60 %")


def _by(found: Iterable[Trial], of: Callable[[Trial], str]) -> list[tuple[str, list[Trial]]]:
    """Trials in groups of one name, in the order of the names."""
    made: dict[str, list[Trial]] = defaultdict(list)
    for one in found:
        made[of(one)].append(one)
    return sorted(made.items())


def _pairs(found: list[Trial]) -> Iterator[Row]:
    yield _row("confounded pairs, d′ ≥ 20, standard run alone: exactly", found, lambda one: one.exact, "")
    yield _row("… in a first class of ≤ 3", found, lambda one: one.in_first_class, "")


def _imported_clean(found: list[Trial]) -> Iterator[Row]:
    known = [one for one in found if one.known]
    yield _row("imported, clean, noise known: adequate", known, lambda one: one.is_said("adequate"), "≥ 95 %")
    for kind, here in _by(known, lambda one: one.answer.bench):
        yield _row(f"… {kind}", here, lambda one: one.is_said("adequate"), "")
    yield _row("imported, clean: an effect named", found, lambda one: bool(one.result["named"]), "≤ 1 %")


def _imported_unknown(found: list[Trial]) -> Iterator[Row]:
    what = "imported, clean, noise not known independently: undecided"
    yield _row(what, [one for one in found if not one.known], lambda one: one.is_said("undecided"), "100 %")
    shown = [one for one in found if one.known]
    yield _row("… known by the band above the motion: adequate", shown, lambda one: one.is_said("adequate"), "≥ 95 %")
    yield _row("… an effect named", found, lambda one: bool(one.result["named"]), "≤ 1 %")


def _imported_one(found: list[Trial]) -> Iterator[Row]:
    strong = [one for one in found if one.answer.d_prime >= STRONG]
    what = "imported, one effect, d′ ≥ 20: in a first class of ≤ 3"
    yield _row(what, strong, lambda one: one.in_first_class, "≥ 95 %")
    for kind, here in _by(strong, lambda one: one.answer.bench):
        yield _row(f"… {kind}", here, lambda one: one.in_first_class, "")
    for kind, here in _by(found, lambda one: one.answer.bench):
        weak = [one for one in here if one.answer.d_prime < STRONG]
        yield _row(f"… {kind}, d′ 10 to 20", weak, lambda one: one.in_first_class, "")
    few = [one for one in strong if one.answer.names[0] not in FAMILY]
    what = "… without delays, lags, averages and filters, of which more than three may look alike"
    yield _row(what, few, lambda one: one.in_first_class, "")
    yield _row("… exactly, all d′", found, lambda one: one.exact, "")
    yield _row("… said to be adequate, d′ ≥ 20", strong, lambda one: one.is_said("adequate"), "")
    right = [one for one in found if one.exact]
    yield _row("… exact, but marked as depending on the band", right, lambda one: one.depends_on_band, "")


def _faults(found: list[Trial]) -> Iterator[Row]:
    yield _row("imported, faults, d′ ≥ 30: adequate", found, lambda one: one.is_said("adequate"), "≤ 1 %")
    shown = [one for one in found if one.answer.hidden[0].get("detected", 0.0) >= LEAST_FAULTY]
    what = "… of those of d′ ≥ 30 in what is compared too, where gain and zero are free: adequate"
    yield _row(what, shown, lambda one: one.is_said("adequate"), "")
    yield _row("… a physical effect named with p ≥ 0.9", found, lambda one: one.wrong_and_sure, "≤ 1 %")
    for name, here in _by(found, lambda one: f"{one.answer.names[0]}, {one.answer.bench}"):
        yield _row(f"… {name}: adequate", here, lambda one: one.is_said("adequate"), "")


def _imported_strangers(found: list[Trial]) -> Iterator[Row]:
    known = [one for one in found if one.known]
    yield from _unlisted("imported, strangers, d′ ≥ 20, noise known: unlisted", known)
    rest = [one for one in found if not one.known]
    what = "imported, strangers, d′ ≥ 20, noise not known: unlisted or undecided"
    yield _row(what, rest, lambda one: one.is_said("unlisted") or one.is_said("undecided"), "")


def _times(found: Sequence[Trial]) -> Iterator[Row]:
    for bench in ("shaker", "turntable"):
        seconds = [one.result["seconds"] for one in found if one.answer.bench == bench and "seconds" in one.result]
        if seconds:
            said = f"median {statistics.median(seconds):.2f} s, largest {max(seconds):.2f} s"
            yield Row(f"diagnosis after loading, {bench}", said, "≤ 1 s", len(seconds))
    failed = [one for one in found if one.result["verdict"] == "failed"]
    if failed:
        yield Row("diagnosis failed with an error", share(len(failed), len(found)), "0", len(found))


@dataclass(frozen=True)
class Reliability:
    """Statements of nearly one probability: how many, their mean probability, and how many were right."""

    of: str
    low: float
    high: float
    count: int
    mean: float
    right: int

    @property
    def honest(self) -> bool:
        """Whether the mean lies within the interval of the frequency."""
        low, high = limits(self.right, self.count)
        return low <= self.mean <= high

    def row(self) -> tuple[str, ...]:
        """A line of the page."""
        said = "yes" if self.honest else "too sure" if self.mean > self.right / self.count else "too modest"
        stated = f"{self.low:g} to {self.high:g}"
        return self.of, stated, f"{self.mean:.3f}", share(self.right, self.count), said


def reliability(found: Sequence[Trial]) -> Iterator[Reliability]:
    """Stated probability against frequency of being right, for every kind of world, own and imported.

    Every effect that was said to be possible is one statement; it is right if the effect is among those hidden.
    """
    for imported in (False, True):
        for words, tables in POPULATIONS.items():
            here = [one for one in found if one.imported == imported and one.table in tables]
            said = [(value, name in one.answer.names) for one in here for name, value in one.stated]
            of = f"{words}, {'imported' if imported else 'own bench'}"
            for place, (low, high) in enumerate(itertools.pairwise(STATED)):
                inside = [(value, good) for value, good in said if bisect_right(STATED[1:-1], value) == place]
                if inside:
                    mean = statistics.fmean(value for value, _ in inside)
                    yield Reliability(of, low, high, len(inside), mean, sum(good for _, good in inside))


def wrong_and_sure(found: Sequence[Trial]) -> Iterator[Row]:
    """Worlds in which a wrong name has a probability of at least 0.9."""
    for imported, what, bar in ((False, "own bench", "≤ 1 %"), (True, "imported", "≤ 2 %")):
        here = [one for one in found if one.imported == imported]
        if here:
            yield _row(f"a wrong name with probability ≥ {SURE}, {what}", here, lambda one: one.wrong_and_sure, bar)


def by_effect(found: Sequence[Trial]) -> list[tuple[str, str, str, str, str]]:
    """For every effect: bench, name, exact, in the first class, and what was said instead."""
    made = []
    of: dict[tuple[str, str], list[Trial]] = defaultdict(list)
    for one in found:
        if one.table in ("one", "imported_one"):
            of[one.answer.bench, one.answer.names[0]].append(one)
    for (bench, name), here in of.items():
        instead: dict[str, int] = defaultdict(int)
        for one in here:
            if not one.exact:
                instead[f"{one.result['verdict']}: {' + '.join(one.result['named']) or 'nothing'}"] += 1
        said = "; ".join(f"{count} × {what}" for what, count in sorted(instead.items(), key=lambda kv: -kv[1])[:3])
        exact, held = (sum(flags) for flags in zip(*((t.exact, t.in_first_class) for t in here), strict=True))
        made.append((bench, name, f"{exact}/{len(here)}", f"{held}/{len(here)}", said))
    return made
