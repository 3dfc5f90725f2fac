"""The page itself: rows and texts from a calibration, put into the template with the figures.

One HTML file with everything in it: no script, no font and no image from elsewhere.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.archive.records import Recorded
from rig.calibrate.budget import Contribution
from rig.calibrate.calibration import AnalyzerPoint, Calibration, Check, PaperRow, ResponsePoint, Result, shown, text
from rig.errors import BadInput
from rig.printed import SHOWN, rounded
from rig.report import figures
from rig.report.figures import PLANS, Drawing

TEMPLATE = "page.html.j2"


@dataclass(frozen=True)
class Estimate:
    """One estimate of the paper's method beside ours: as text, and how far it lies from ours in percent."""

    name: str
    value: str
    away: str


@dataclass(frozen=True)
class TableRow:
    """One channel in the paper's Table I or II."""

    row: str
    channel: str
    ours: str
    nominal: str
    deviation: str
    unit: str
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class Shown:
    """One figure in the page, numbered by its title."""

    title: str
    svg: str
    caption: str


@dataclass(frozen=True)
class Missing:
    """A figure that the runs do not allow, why, and the command whose run would give it."""

    title: str
    why: str
    command: str


def write_report(calibration: Calibration, runs: Sequence[Recorded], path: Path) -> None:
    """Write the report of a calibration, with figures from the runs that it was made from, as one HTML file.

    Raises OSError if the file cannot be written. The same calibration and runs give the same bytes.
    """
    from rig.archive.durable import write_whole

    write_whole(path, page(calibration, runs).encode())


def page(calibration: Calibration, runs: Sequence[Recorded]) -> str:
    """The report as HTML."""
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
    from markupsafe import Markup

    drawn, missing = _drawn(calibration, runs)
    environment = Environment(
        loader=PackageLoader("rig.report", "."),
        autoescape=select_autoescape(["html", "j2"], default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(TEMPLATE).render(
        c=calibration,
        made=day(calibration.made),
        sources=[(s, day(s.started)) for s in calibration.sources],
        standards=[(s, ", ".join(_values(s))) for s in calibration.standards],
        conditions=list(_conditions(calibration)),
        tables=[(name, list(table(calibration, name))) for name in ("I", "II")],
        results=[(r, text(r), verdict_text(r), limits(r)) for r in calibration.results],
        budgets=[(r, text(r), list(budget_lines(r))) for r in calibration.results if r.budget is not None],
        responses=[(channel, list(map(_response, points))) for channel, points in calibration.responses.items()],
        beside=beside,
        analyzer=[(channel, list(map(_analyzer, points))) for channel, points in calibration.analyzer.items()],
        figures=[(one, Markup(one.svg)) for one in drawn],  # noqa: S704 - our own drawing, its texts escaped by it
        missing=missing,
    )


def _drawn(calibration: Calibration, runs: Sequence[Recorded]) -> tuple[list[Shown], list[Missing]]:
    drawn, missing = [], []
    simulated = calibration.simulated or any(run.header["simulated"] for run in runs)
    for plan in PLANS:
        found = _drawing(plan, calibration, runs)
        if isinstance(found, str):
            missing.append(Missing(plan.title, found, plan.command))
        else:
            drawn.append(Shown(plan.title, figures.svg(found.figure, simulated), found.caption))
    return drawn, missing


def _drawing(plan: figures.Plan, calibration: Calibration, runs: Sequence[Recorded]) -> Drawing | str:
    """The drawing, or why there is none."""
    try:
        return plan.draw(calibration, runs) or "no run of this calibration holds what it shows"
    except BadInput as error:
        return str(error)


def day(seconds: float) -> str:
    """Date and time of day, UTC."""
    return dt.datetime.fromtimestamp(seconds, dt.UTC).strftime("%Y-%m-%d %H:%M UTC")


def _values(standard: Mapping[str, Any]) -> Iterator[str]:
    for name, stated in standard["values"].items():
        yield f"{name} {stated['value']}, U = {stated['expanded_uncertainty']} (k = {stated['coverage_factor']:g})"


def _conditions(calibration: Calibration) -> Iterator[str]:
    units = {"temperature": ("°C", 1), "supply": ("V", 4)}
    for name, (mean, low, high) in calibration.conditions.items():
        unit, places = units.get(name, ("", 3))
        yield f"{name} {mean:.{places}f} {unit} ({low:.{places}f} to {high:.{places}f} {unit})"


def table(calibration: Calibration, name: str) -> Iterator[TableRow]:
    """Rows of the paper's Table I or II, one for every channel that has estimates or a calibration of its kind."""
    by_channel: dict[str, list[PaperRow]] = {}
    for row in calibration.paper:
        if row.table == name:
            by_channel.setdefault(row.channel, []).append(row)
    for channel, rows in by_channel.items():
        first = rows[0]
        unit, factor = SHOWN.get(first.unit, (first.unit, 1.0))
        ours = calibration.find(first.ours)
        deviation = calibration.find(f"{channel}.deviation")
        yield TableRow(
            row=first.row,
            channel=channel,
            ours=_number(ours) if ours else "not determined",
            nominal=f"{first.nominal * factor:.4g}" if first.nominal is not None else "–",
            deviation=text(deviation) if deviation else "–",
            unit=unit,
            estimates=tuple(_estimate(row, factor, ours) for row in rows),
        )


def _number(result: Result) -> str:
    value, expanded, _ = shown(result)
    number, uncertainty = rounded(value, expanded)
    return f"{number} ± {uncertainty}"


def _estimate(row: PaperRow, factor: float, ours: Result | None) -> Estimate:
    away = "" if ours is None or not ours.value else f"{(row.value / ours.value - 1.0) * 100.0:+.2f} %"
    return Estimate(row.estimate, f"{row.value * factor:#.4g}", away)


def verdict_text(result: Result) -> str:
    """The verdict and the status, as far as there is something to say."""
    said = [result.ruling, "" if result.status == "determined" else result.status]
    return ", ".join(filter(None, said)) or "–"


def limits(result: Result) -> str:
    """What the verdict was judged against, in the unit on paper."""
    unit, factor = SHOWN.get(result.unit, (result.unit, 1.0))
    low, high = (None if x is None else f"{x * factor:.5g}" for x in (result.low, result.high))
    if low is None or high is None:
        return f"at least {low} {unit}" if low else f"at most {high} {unit}" if high else ""
    return f"{low} to {high} {unit}"


@dataclass(frozen=True)
class BudgetLine:
    """One contribution, as text; `share` of the variance in percent, the sum of squares being whole."""

    name: str
    kind: str
    distribution: str
    u: str
    sensitivity: str
    contribution: str
    dof: str
    share: float
    source: str


def budget_lines(result: Result) -> Iterator[BudgetLine]:
    """Contributions of a result, largest first."""
    unit, factor = SHOWN.get(result.unit, (result.unit, 1.0))
    total = sum(c.contribution**2 for c in result.contributions) or 1.0
    for c in sorted(result.contributions, key=lambda c: -abs(c.contribution)):
        yield BudgetLine(
            name=c.name,
            kind=c.kind,
            distribution=c.distribution,
            u=f"{c.u:.2g} {'' if c.unit == '1' else c.unit}".strip(),
            sensitivity=f"{c.sensitivity:.3g} {_per(result.unit, c)}".strip(),
            contribution=f"{abs(c.contribution) * factor:.2g} {unit}",
            dof="∞" if math.isinf(c.dof) else f"{c.dof:.0f}",
            share=100.0 * c.contribution**2 / total,
            source=c.source,
        )


def _per(unit: str, contribution: Contribution) -> str:
    if unit == contribution.unit:
        return ""
    return unit if contribution.unit == "1" else f"({unit})/({contribution.unit})"


def beside(check: Check, unit: str) -> str:
    """`beside it 650.2 mV/g (off-line: …), Δ = −0.3 of u(Δ) 0.9 mV/g: agrees`."""
    name, factor = SHOWN.get(unit, (unit, 1.0))
    delta, u = rounded(check.delta * factor, check.u_delta * abs(factor))
    value = rounded(check.value * factor, check.u * abs(factor))[0]
    verdict = "agrees" if check.agrees else "does not agree"
    return f"beside it {value} {name} ({check.method}): Δ = {delta} {name}, u(Δ) = {u} {name}, {verdict}"


def _analyzer(point: AnalyzerPoint) -> dict[str, str]:
    return _measured(point) | {"coherence": f"{point.coherence:.6f}"}


def _response(point: ResponsePoint) -> dict[str, str]:
    distortion = f"{100.0 * point.distortion:.2g} %" if math.isfinite(point.distortion) else "–"
    return _measured(point) | {"distortion": distortion}


def _measured(point: ResponsePoint | AnalyzerPoint) -> dict[str, str]:
    unit, factor = SHOWN["V/(m/s²)"]
    degrees = SHOWN["rad"][1]
    magnitude = rounded(point.magnitude * factor, 2.0 * point.uc_magnitude * factor)
    phase = rounded(point.phase * degrees, 2.0 * point.uc_phase * degrees)
    return {
        "frequency": f"{point.frequency:.2f}",
        "level": point.level,
        "acceleration": f"{point.acceleration:.3f}",
        "magnitude": f"{magnitude[0]} ± {magnitude[1]}",
        "phase": f"{phase[0]} ± {phase[1]}",
        "flags": "; ".join(point.flags),
        "unit": unit,
    }
