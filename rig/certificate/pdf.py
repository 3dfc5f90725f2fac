"""The certificate as a laboratory prints it: one to three pages A4 with results, budget and traceability.

The page is `certificate.typ`, the texts are data beside it: nothing that a calibration says is ever read as markup.
Contents after ISO/IEC 17025:2017, 7.8.2, 7.8.4 and 7.8.6.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rig.archive.durable import write_whole
from rig.calibrate.calibration import COMBINED, Calibration, Result
from rig.certificate.document import COVERAGE, DECISION, budgeted, document, flat, limits, printed, standard_rows
from rig.errors import BadInput
from rig.printed import SHOWN

if TYPE_CHECKING:
    from rig.certificate.issuer import Issuer

TEMPLATE = Path(__file__).with_name("certificate.typ")
MOST_PAGES = 3
SIZES = (8.6, 8.0, 7.2, 6.5)  # pt; the smaller ones for a calibration that fills more than three pages
WORTH_A_PAGE = 0.25
KEY = (COMBINED, "sensitivity", "sensitivity_gravity", "offset", "deviation", "noise_density")
WIDEST = 6  # columns of one table
NOTHING: Mapping[str, bytes] = MappingProxyType({})
KINDS = (("Accelerometers", "m/s²"), ("Gyros", "rad"))
QUANTITIES = {"acceleration": "Accelerometers", "rate": "Gyros"}
NOT_DETERMINED, PREFIX = "n. d.", "not determined: "


def write_pdf(
    calibration: Calibration, path: Path, figures: Mapping[str, bytes] = NOTHING, issuer: Issuer | None = None
) -> None:
    """Write the certificate; the same calibration gives the same bytes.

    `figures` are SVG pictures by name; the name is printed below. Raises BadInput without results, for texts that
    cannot be printed, and for a figure that is no SVG.
    """
    write_whole(path, compiled(calibration, figures, issuer))


def compiled(calibration: Calibration, figures: Mapping[str, bytes] = NOTHING, issuer: Issuer | None = None) -> bytes:
    """The certificate as PDF, in the largest type that keeps all but its annex of budgets within three pages."""
    body = content(calibration, issuer) | {"figures": _pictures(figures)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / TEMPLATE.name).write_bytes(TEMPLATE.read_bytes())
        for row, picture in zip(body["figures"], figures.values(), strict=True):
            (folder / row["file"]).write_bytes(picture)
        return _largest(folder / TEMPLATE.name, body, calibration.made)


def _largest(file: Path, body: Mapping[str, Any], made: float) -> bytes:
    """The first size that fits and does not leave the last page all but empty; else the first that fits at all."""
    kept = b""
    for size in SIZES:
        (file.parent / "data.json").write_text(json.dumps({**body, "size": size}), encoding="utf-8")
        pdf, pages, filled = _typeset(file, made)
        if pages <= MOST_PAGES:
            kept = kept or pdf
            if pages == 1 or filled > WORTH_A_PAGE:
                return pdf
    return kept or pdf


def _typeset(file: Path, made: float) -> tuple[bytes, int, float]:
    """The PDF, how many pages stand before its annex, and how far down the last of them is filled (0 to 1)."""
    import typst

    compiler = typst.Compiler(str(file), root=str(file.parent), ignore_system_fonts=True)
    try:
        pdf = compiler.compile(format="pdf", timestamp=int(made))
        end = json.loads(compiler.query("<end>", field="value", one=True))
    except typst.TypstError as error:
        raise BadInput(f"certificate: found what cannot be typeset ({error}), wanted plain texts and SVG") from error
    assert isinstance(pdf, bytes)
    return pdf, int(end["pages"]), float(end["filled"])


def _pictures(figures: Mapping[str, bytes]) -> list[dict[str, str]]:
    for name, picture in figures.items():
        if b"<svg" not in picture:
            raise BadInput(f"certificate: figure '{name}': found no SVG, wanted a picture that begins with <svg")
    return [{"name": flat(name), "file": f"figure-{index}.svg"} for index, name in enumerate(figures)]


def content(calibration: Calibration, issuer: Issuer | None = None) -> dict[str, Any]:
    """Everything on the certificate, as texts in lists and mappings; raises BadInput as `document` does."""
    words = document(calibration, issuer)
    notes = _notes(calibration.results)
    standards = standard_rows(calibration)
    return asdict(words) | {
        "coverage": COVERAGE,
        "decision": DECISION,
        "flags": list(dict.fromkeys(flat(flag) for flag in calibration.flags)),
        "standards": standards,
        "overdue": list(_overdue(calibration, standards)),
        "tables": list(_tables(calibration, notes)),
        "conformity": [_conformity(r) for r in calibration.results if r.determined and r.verdict is not None],
        "budgets": [_budget(result) for result in budgeted(calibration)],
        "notes": [_printed_note(text, *note) for text, note in notes.items()],
        "sources": [{**asdict(source), "digest": source.digest[:16]} for source in calibration.sources],
    }


def _overdue(calibration: Calibration, standards: Iterable[Mapping[str, str]]) -> Iterable[str]:
    stated = {row["name"]: f" ({row['certificate']}, due {row['due']})" for row in standards}
    return (name + stated.get(name, "") for name in calibration.overdue)


Notes = Mapping[str, tuple[str, list[Result]]]


def _notes(results: Iterable[Result]) -> Notes:
    """Remarks and reasons, each once with its number and the results that it concerns; reasons come last."""
    found: dict[str, tuple[str, list[Result]]] = {}
    for result in sorted(results, key=lambda r: not r.determined):
        text = _note(result)
        if text:
            found.setdefault(text, (str(len(found) + 1), []))[1].append(result)
    return found


def _note(result: Result) -> str:
    text = "; ".join(flat(remark) for remark in result.remarks)
    if result.status == "flagged" and not text:
        return "without a stated reason"
    return text if result.determined else PREFIX + text


def _printed_note(text: str, mark: str, results: Sequence[Result]) -> dict[str, Any]:
    missing = not results[0].determined
    flagged = any(result.status == "flagged" for result in results)
    shown = {"mark": mark, "text": text.removeprefix(PREFIX), "where": _where(results)}
    return {**shown, "missing": missing, "flagged": flagged}


def _where(results: Sequence[Result]) -> str:
    """`sensitivity of a, b; offset of c`."""
    titles: dict[str, list[str]] = {}
    for result in results:
        titles.setdefault(flat(result.title), []).append(result.channel)
    return "; ".join(f"{title} of {', '.join(dict.fromkeys(channels))}" for title, channels in titles.items())


def _tables(calibration: Calibration, notes: Notes) -> Iterable[dict[str, Any]]:
    """Per kind of sensor one table with the key measurands, and what else there is in tables of at most six columns."""
    kinds: dict[str, dict[str, dict[str, Result]]] = {}
    for result in calibration.results:
        channels = kinds.setdefault(_kind(calibration, result.channel), {})
        channels.setdefault(result.channel, {})[result.measurand] = result
    for kind, channels in kinds.items():
        measurands = list(dict.fromkeys(m for found in channels.values() for m in found))
        keys = [measurand for measurand in KEY if measurand in measurands]
        others = [measurand for measurand in measurands if measurand not in KEY]
        for part, chosen in (("", keys), (", further quantities", others)):
            for start in range(0, len(chosen), WIDEST):
                yield _table(kind + part, channels, chosen[start : start + WIDEST], notes)


def _kind(calibration: Calibration, channel: str) -> str:
    sensor = calibration.under_test
    sensed = sensor.channel(channel).quantity if channel in sensor else channel
    if sensed in (triad.name for triad in sensor.triads):  # angles between its axes
        sensed = sensor.triad(sensed).quantity
    if sensed in QUANTITIES:
        return QUANTITIES[sensed]
    for result in (r for r in calibration.results if r.channel == channel):
        for kind, unit in KINDS:
            if unit in result.unit:
                return kind
    return "Other channels"


def _table(
    heading: str, channels: Mapping[str, Mapping[str, Result]], measurands: Sequence[str], notes: Notes
) -> dict[str, Any]:
    rows = [(name, found) for name, found in channels.items() if any(m in found for m in measurands)]
    columns = [_column([found[m] for _, found in rows if m in found]) for m in measurands]
    cells = [
        [_cell(found.get(m), column, notes) for m, column in zip(measurands, columns, strict=True)] for _, found in rows
    ]
    return {
        "heading": heading,
        "columns": columns,
        "rows": [{"channel": name, "cells": row} for (name, _), row in zip(rows, cells, strict=True)],
    }


def _column(results: Sequence[Result]) -> dict[str, str]:
    """Title, unit, and k where it is the same for all."""
    factors = {_k(result) for result in results if result.budget is not None}
    units = {_shown_unit(result) for result in results}
    return {
        "title": flat(results[0].title),
        "unit": units.pop() if len(units) == 1 else "",
        "k": factors.pop() if len(factors) == 1 else "",
    }


def _cell(result: Result | None, column: Mapping[str, str], notes: Notes) -> dict[str, Any]:
    cell = {"value": "", "expanded": "", "k": "", "mark": "", "unit": "", "flagged": False}
    if result is None:
        return cell
    mark = notes[_note(result)][0] if _note(result) else ""
    if not result.determined:
        return {**cell, "value": NOT_DETERMINED, "mark": mark}
    value, expanded, unit = printed(result)
    stated = result.budget is not None
    return {
        "value": _minus(value),
        "expanded": expanded if stated else "",
        "k": "" if column["k"] or not stated else _k(result),
        "mark": mark,
        "unit": "" if column["unit"] else unit,
        "flagged": result.status == "flagged",
    }


def _k(result: Result) -> str:
    return f"{result.coverage_factor:.2f}"


def _shown_unit(result: Result) -> str:
    return SHOWN.get(result.unit, (result.unit, 1.0))[0]


def _minus(number: str) -> str:
    """The number with a typesetter's minus; none before a zero."""
    zero = not any(digit in number for digit in "123456789")
    return number.replace("-", "" if zero else "−")


def written(number: float, digits: int = 3) -> str:
    """As people write it: 6.2 × 10⁻⁵, never 6.2e-05."""
    mantissa, _, exponent = f"{number:.{digits}g}".partition("e")
    return _minus(mantissa) + (f" × 10{exponent_of(int(exponent))}" if exponent else "")


def exponent_of(power: int) -> str:
    """A power in raised digits."""
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _conformity(result: Result) -> dict[str, str]:
    value, expanded, unit = printed(result)
    uncertainty = "" if result.budget is None else f" ± {expanded}"
    stated = f"{_minus(value)}{uncertainty} {unit}"
    return {
        "channel": result.channel,
        "title": flat(result.title),
        "stated": stated,
        "limits": _minus(limits(result)),
        "verdict": result.ruling,
    }


def _budget(result: Result) -> dict[str, Any]:
    assert result.budget is not None
    unit, factor = SHOWN.get(result.unit, (result.unit, 1.0))
    shares = result.budget.shares()
    value, expanded, _ = printed(result)
    return {
        "heading": f"{result.channel}, {flat(result.title)}",
        "per": result.unit,
        "unit": unit,
        "rows": [
            {
                "name": flat(one.name),
                "source": flat(one.source),
                "kind": one.kind,
                "distribution": one.distribution,
                "dof": _degrees(one.dof),
                "u": written(one.u) + ("" if one.unit == "1" else f" {one.unit}"),
                "sensitivity": written(one.sensitivity, 4),
                "contribution": written(one.contribution * abs(factor)),
                "share": _minus(f"{100 * shares[one.name]:.1f}"),
            }
            for one in result.contributions
        ],
        "u": written(result.u * abs(factor)),
        "dof": _degrees(result.dof),
        "k": _k(result),
        "stated": f"{_minus(value)} ± {expanded} {unit}",
    }


def _degrees(dof: float) -> str:
    return "∞" if math.isinf(dof) or dof >= 1e5 else f"{dof:.0f}"
