"""A calibration as a value: results with their budgets, what they were measured from, and the YAML file that keeps it.

A result never travels alone: value, unit, standard and expanded uncertainty, the budget that they come from, the
reference, the method, and what there is to say against it. What could not be determined is a result too, with the
reason in place of a value. Everything is SI; `shown` gives a result in the units that laboratories print.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig.calibrate.budget import Budget, Contribution
from rig.errors import BadInput
from rig.printed import SHOWN, rounded
from rig.sensor import AXES, ROTATIONS, Sensor

FORMAT = 1
PROBABILITY = 0.95
SIGN_REVERSED = "sign reversed"  # the first words of why a verdict is `fail`, where it is not the size

COMBINED = "sensitivity_combined"
ROUTES = ("sensitivity", "sensitivity_gravity", "sensitivity_centripetal")  # of one quantity, by several references

MISSING = "an effect is missing"  # in the remark on a value whose model leaves more than noise

Status = Literal["determined", "flagged", "not determined"]
Verdict = Literal["pass", "fail", "inconclusive"]


@dataclass(frozen=True)
class Check:
    """The direct estimate of a value beside the fitted one: `delta` apart, with the uncertainty of that difference.

    Both are made from the same rows, so `u_delta` is not the root of the sum of their squares.
    """

    method: str
    value: float
    u: float
    delta: float
    u_delta: float

    @property
    def agrees(self) -> bool:
        """|Δ| ≤ 2·u(Δ)."""
        return abs(self.delta) <= 2.0 * self.u_delta

    @property
    def away(self) -> float:
        """|Δ|/u(Δ)."""
        return abs(self.delta) / self.u_delta


@dataclass(frozen=True)
class Result:
    """One measurand of one channel, in SI.

    `key` is `<channel>.<measurand>`, unique in a calibration. `value` and `budget` are None if it was not determined;
    `remarks` then say why, and otherwise what a reader must know (a flagged result always has one). `low` and `high`
    are the limits that `verdict` was judged against. `title` is the measurand in a reader's words. `check` holds what
    another estimator makes of the same records.
    """

    channel: str
    measurand: str
    title: str
    value: float | None
    unit: str
    budget: Budget | None = None
    method: str = ""
    reference: str = ""
    status: Status = "determined"
    remarks: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    verdict: Verdict | None = None
    check: Check | None = None

    @property
    def key(self) -> str:
        return f"{self.channel}.{self.measurand}"

    @property
    def determined(self) -> bool:
        return self.value is not None

    @property
    def rejected(self) -> bool:
        """Whether it was measured and cannot be believed; the remarks say why."""
        return self.value is None and self.verdict is not None

    @property
    def ruling(self) -> str:
        """The verdict in words, "" without one: a failure of the sign is said to be one."""
        turned = any(remark.startswith(SIGN_REVERSED) for remark in self.remarks)
        return f"{self.verdict}: {SIGN_REVERSED}" if self.verdict == "fail" and turned else self.verdict or ""

    @property
    def contributions(self) -> tuple[Contribution, ...]:
        """Lines of the budget; none for what was not determined."""
        return () if self.budget is None else self.budget.contributions

    @property
    def u(self) -> float:
        """Combined standard uncertainty, in `unit`; NaN for what was not determined."""
        return math.nan if self.budget is None else self.budget.u

    @property
    def dof(self) -> float:
        """Effective degrees of freedom."""
        return math.nan if self.budget is None else self.budget.dof

    @property
    def coverage_factor(self) -> float:
        """k for 95 %, from the effective degrees of freedom."""
        return math.nan if self.budget is None else self.budget.coverage_factor(PROBABILITY)

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k·u for 95 %, in `unit`."""
        return math.nan if self.budget is None else self.budget.expanded(PROBABILITY)


def _named(calibration: Calibration) -> Sensor:
    """Of a file from before the sensor was kept with it: its channels were always called `<unit>_<axis>`.

    Only what belongs together is known; sensitivity, range and the like are placeholders.
    """
    rows: dict[str, dict[str, str]] = {}
    for name in calibration.channels():
        unit, _, word = name.rpartition("_")
        quantity, si = ("rate", "rad/s") if word in ROTATIONS else ("acceleration", "m/s²")
        if (axis := ROTATIONS.get(word, word)) in AXES:
            rows[name] = {"part": "", "unit": unit, "quantity": quantity, "axis": axis, "range": ""}
            rows[name] |= {"sensitivity": f"1 V/({si})", "bandwidth": "1 Hz"}
    return Sensor.stated({"sensor": calibration.sensor, "serial": calibration.serial, "channels": rows})


def not_determined(channel: str, measurand: str, title: str, unit: str, why: str) -> Result:
    """A result that says why there is none."""
    return Result(channel, measurand, title, None, unit, status="not determined", remarks=(why,))


def rejected(channel: str, measurand: str, title: str, unit: str, why: str) -> Result:
    """The same for what was measured and cannot be believed: nobody can tell whether limits are kept."""
    return replace(not_determined(channel, measurand, title, unit, why), verdict="inconclusive")


@dataclass(frozen=True)
class ResponsePoint:
    """One frequency and level of a channel's frequency response against the reference.

    `magnitude` V/(m/s²) and `phase` rad, each with its standard uncertainty without (`u_…`) and with the reference
    (`uc_…`). `distortion`: harmonics of the sensor's output that the motion does not explain, relative to the
    fundamental. `acceleration` is the peak that the reference saw, m/s².
    """

    frequency: float
    level: str
    acceleration: float
    magnitude: float
    phase: float
    u_magnitude: float
    u_phase: float
    uc_magnitude: float
    uc_phase: float
    distortion: float
    run: str
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class AnalyzerPoint:
    """The same as the analyzer measured it at the bench; `coherence` is γ² in the line at the frequency."""

    frequency: float
    level: str
    acceleration: float
    magnitude: float
    phase: float
    u_magnitude: float
    u_phase: float
    uc_magnitude: float
    uc_phase: float
    coherence: float
    run: str
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class PaperRow:
    """One value of the paper's method, kept beside ours: `estimate` names the equation; SI; no uncertainty claimed.

    `table` is "I" or "II"; `row` its label there; `nominal` the data sheet's value; `ours` the key of the result that
    measures the same.
    """

    table: str
    row: str
    channel: str
    estimate: str
    value: float
    unit: str
    nominal: float | None
    ours: str


@dataclass(frozen=True)
class Source:
    """A run that the calibration was made from: `digest` is the SHA-256 of its seal, "" for a run without one."""

    run: str
    procedure: str
    status: str
    digest: str
    started: float


@dataclass(frozen=True)
class Calibration:
    """Everything that was concluded about one unit, and from what.

    `made` is the bench-clock time (s since 1970 UTC) of the newest record used. `conditions` holds mean, lowest and
    highest `temperature` (°C) and `supply` (V). `standards` are as in the bench file. `overdue` names standards that
    were used past their due date by explicit order. `flags` concern the calibration as a whole. `unit` is the sensor
    file's content.
    """

    name: str
    sensor: str
    serial: str
    made: float
    simulated: bool
    sources: tuple[Source, ...]
    standards: tuple[Mapping[str, Any], ...]
    conditions: Mapping[str, tuple[float, float, float]]
    results: tuple[Result, ...]
    responses: Mapping[str, tuple[ResponsePoint, ...]] = field(default_factory=dict)
    analyzer: Mapping[str, tuple[AnalyzerPoint, ...]] = field(default_factory=dict)
    paper: tuple[PaperRow, ...] = ()
    overdue: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    program: Mapping[str, str] = field(default_factory=dict)
    model: str = ""  # what the values stand on; "" where they are direct estimates
    unit: Mapping[str, Any] = field(default_factory=dict)

    @property
    def under_test(self) -> Sensor:
        """The unit as its sensor file states it; of a calibration from before it was kept, as its results name it."""
        return Sensor.stated(self.unit) if self.unit else _named(self)

    @property
    def agreement(self) -> str:
        """How many values another estimator confirms from the same records, and the furthest; "" without any."""
        checked = [(r, r.check) for r in self.results if r.check is not None]
        if not checked:
            return ""
        agreeing = sum(check.agrees for _, check in checked)
        result, check = max(checked, key=lambda one: one[1].away)
        return (
            f"{agreeing} of {len(checked)} direct estimates agree; the furthest, of {result.key}, lies "
            f"{check.away:.1f} standard uncertainties of the difference away (2 at most)"
        )

    def result(self, key: str) -> Result:
        """One result; raises BadInput if there is none of that key."""
        for result in self.results:
            if result.key == key:
                return result
        raise BadInput(f"calibration {self.name}: found no result '{key}', wanted one of its results")

    def find(self, key: str) -> Result | None:
        """One result, None if it is missing or was not determined."""
        return next((r for r in self.results if r.key == key and r.determined), None)

    def of(self, measurand: str) -> Iterator[Result]:
        """All determined results of one measurand."""
        return (r for r in self.results if r.measurand == measurand and r.determined)

    def channels(self) -> tuple[str, ...]:
        """Channels that have results, in their order."""
        return tuple(dict.fromkeys(r.channel for r in self.results))

    def covariance(self, keys: Sequence[str]) -> NDArray[np.float64]:
        """Covariance of results, shape (n, n), SI: contributions of one name and source are one and the same error."""
        return covariance_of([self.result(key) for key in keys])

    def to_use(self, channel: str, measurand: str) -> Result | None:
        """The one value of a channel to use, None if there is none: of a sensitivity that of all references combined,
        else what a sweep or the turntable gave, else gravity's. One that was measured and not believed has no other.
        """
        if measurand != "sensitivity":
            return self.find(f"{channel}.{measurand}")
        listed = {r.measurand: r for r in self.results if r.channel == channel}
        if any(r.rejected for name, r in listed.items() if name in ROUTES):
            return None
        found = [r for name in (COMBINED, *ROUTES[:2]) if (r := listed.get(name)) is not None and r.determined]
        return min(found, key=lambda r: (r.measurand != COMBINED, r.status == "flagged"), default=None)

    def used(self, measurand: str) -> Iterator[Result]:
        """What `to_use` gives of all channels that have it."""
        return (r for channel in self.channels() if (r := self.to_use(channel, measurand)) is not None)


def covariance_of(results: Sequence[Result]) -> NDArray[np.float64]:
    """Covariance of results, shape (n, n), SI, as `Calibration.covariance`."""
    rows = [_by_origin(one) for one in results]
    found = np.array([[sum(a[o] * b[o] for o in a.keys() & b.keys()) for b in rows] for a in rows], np.float64)
    np.fill_diagonal(found, [one.u**2 for one in results])
    return found


def _by_origin(result: Result) -> dict[tuple[str, ...], float]:
    """Signed contributions by origin; what is of type A belongs to its own result alone."""
    return {
        (c.name, c.source) if c.kind == "B" else (result.key, c.name): c.sensitivity * c.u for c in result.contributions
    }


def shown(result: Result) -> tuple[float, float, str]:
    """Value, expanded uncertainty and unit as laboratories print them; NaN for what was not determined."""
    unit, factor = SHOWN.get(result.unit, (result.unit, 1.0))
    if result.value is None:
        return math.nan, math.nan, unit
    return result.value * factor, result.expanded * abs(factor), unit


def text(result: Result) -> str:
    """`650.1 ± 6.5 mV/g`, or why there is no value."""
    if result.value is None:
        return f"not determined: {'; '.join(result.remarks)}"
    value, expanded, unit = shown(result)
    number, uncertainty = rounded(value, expanded)
    return f"{number} ± {uncertainty} {unit}"


def path_of(runs: Path, name: str) -> Path:
    """Where a calibration of that name is kept; raises BadInput for a name that is no file name."""
    if not name or any(c in name for c in "/\\\0") or name.startswith("."):
        raise BadInput(f"calibration: found the name '{name}', wanted a plain file name without folders")
    return runs / "calibrations" / f"{name}.yaml"


def save(calibration: Calibration, path: Path) -> None:
    """Write a calibration; the file appears whole or not at all."""
    import yaml

    from rig.archive.durable import write_whole

    body = {"format": FORMAT, **_plain(asdict(calibration))}
    for result, row in zip(calibration.results, body["results"], strict=True):
        row |= {} if result.value is None else _stated(result)
    writer = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    write_whole(path, yaml.dump(body, Dumper=writer, allow_unicode=True, sort_keys=False, width=118).encode())


def _stated(result: Result) -> dict[str, float]:
    """What a reader wants to see; worked out anew from the budget when the file is read."""
    return {"u": result.u, "dof": result.dof, "k": result.coverage_factor, "expanded": result.expanded}


def load(path: Path) -> Calibration:
    """Read a calibration; raises BadInput if the file is missing, or is none of this program's."""
    import yaml

    try:
        body = _read(path.read_bytes())
    except FileNotFoundError:
        known = sorted(p.stem for p in path.parent.glob("*.yaml"))
        wanted = f"one of {', '.join(known)}" if known else "one made by `rig calibrate all`"
        raise BadInput(f"calibration: found no '{path.stem}' in {path.parent}, wanted {wanted}") from None
    except yaml.YAMLError as error:
        raise BadInput(f"{path}: found no YAML ({error}), wanted a calibration") from error
    if not isinstance(body, dict) or body.pop("format", None) != FORMAT:
        raise BadInput(f"{path}: found no calibration of format {FORMAT}, wanted a file made by `rig calibrate all`")
    try:
        return _calibration(body)
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(
            f"{path}: found a calibration with parts missing or changed ({error}), wanted it whole"
        ) from error


def _read(data: bytes) -> Any:
    """Plain data by the safe loader, the one in C where there is one: a calibration has thousands of lines."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(data)
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


def _calibration(body: Mapping[str, Any]) -> Calibration:
    known = {name: body[name] for name in ("name", "sensor", "serial", "made", "simulated", "program")}
    return Calibration(
        **known,
        sources=tuple(Source(**row) for row in body["sources"]),
        standards=tuple(body["standards"]),
        conditions={name: (v[0], v[1], v[2]) for name, v in body["conditions"].items()},
        results=tuple(_result(row) for row in body["results"]),
        responses={
            channel: tuple(ResponsePoint(**{**row, "flags": tuple(row["flags"])}) for row in rows)
            for channel, rows in body["responses"].items()
        },
        analyzer={
            channel: tuple(AnalyzerPoint(**{**row, "flags": tuple(row["flags"])}) for row in rows)
            for channel, rows in (body.get("analyzer") or {}).items()
        },
        paper=tuple(PaperRow(**row) for row in body["paper"]),
        overdue=tuple(body["overdue"]),
        flags=tuple(body["flags"]),
        model=str(body.get("model", "")),
        unit=body.get("unit") or {},
    )


def _result(row: Mapping[str, Any]) -> Result:
    derived = ("budget", "check", "u", "dof", "k", "expanded")
    kept = {name: value for name, value in row.items() if name not in derived}
    check = None if row.get("check") is None else Check(**row["check"])
    budget = row["budget"]
    if budget is not None:
        contributions = tuple(Contribution(**one) for one in budget["contributions"])
        correlation = {tuple(pair["between"]): pair["r"] for pair in budget["correlation"]}
        budget = Budget(contributions, correlation)
    return Result(**{**kept, "remarks": tuple(row["remarks"])}, budget=budget, check=check)


def _plain(value: Any) -> Any:
    """Mappings, lists and numbers that YAML can hold; correlations of pairs become a list."""
    if isinstance(value, Mapping):
        if value and all(isinstance(key, tuple) for key in value):
            return [{"between": list(key), "r": float(r)} for key, r in value.items()]
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    if isinstance(value, (np.floating, np.integer)):
        return value.item()
    return value
