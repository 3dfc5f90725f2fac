"""What both forms of the certificate say: one value of plain text, built from a calibration."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rig.calibrate.calibration import COMBINED, Calibration, Result, shown
from rig.calibrate.judging import like_sensors
from rig.errors import BadInput
from rig.printed import SHOWN, rounded

if TYPE_CHECKING:
    from rig.certificate.issuer import Issuer

COVERAGE = (
    "The reported expanded uncertainty U is the standard uncertainty multiplied by the coverage factor k given with "
    "each result, which for a t-distribution with the effective degrees of freedom corresponds to a coverage "
    "probability of 95 % (JCGM 100:2008, clause G.4)."
)
DECISION = (
    "Decision rule: guard band w = U on both sides of each limit. Pass: the interval y ± U lies within the limits. "
    "Fail: it lies wholly outside. Otherwise inconclusive (ISO 14253-1:2017, ILAC-G8:09/2019 4.2.3), as is what is "
    "flagged. The probability of accepting what is outside, or rejecting what is inside, is at most 2.5 % per limit. "
    "The limits are those stated for the item by its data sheet or its owner."
)
NOT_STATED = "not stated"
SIMULATED = (
    "SIMULATED: these results come from a simulated bench. No physical item was calibrated; this is no evidence of "
    "metrological traceability."
)


@dataclass(frozen=True)
class Document:
    """Texts of the certificate. Dates are ISO 8601, UTC."""

    title: str
    identifier: str
    sensor: str
    serial: str
    begun: str
    ended: str
    simulated: bool
    laboratory: str
    customer: str
    order: str
    place: str
    issued: str
    signatories: tuple[tuple[str, str], ...]
    model: str
    agreement: str
    methods: tuple[str, ...]
    conditions: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    remarks: tuple[str, ...]
    missing: tuple[tuple[str, str, str], ...]
    program: str


def document(calibration: Calibration, issuer: Issuer | None = None) -> Document:
    """The certificate's texts; raises BadInput without results, or for a name or serial that cannot be printed."""
    if not calibration.results:
        raise BadInput(f"certificate of {calibration.name}: found no results, wanted at least one")
    for what in ("name", "sensor", "serial"):
        printable(getattr(calibration, what), f"certificate: {what}")
    starts = [source.started for source in calibration.sources] or [calibration.made]
    return Document(
        title="Calibration certificate",
        identifier=identifier(calibration, issuer),
        sensor=calibration.sensor,
        serial=calibration.serial,
        begun=_date(min(starts)),
        ended=_date(calibration.made),
        simulated=calibration.simulated,
        **_issued(calibration, issuer),
        model=flat(calibration.model),
        agreement=calibration.agreement,
        methods=tuple(dict.fromkeys(r.method for r in calibration.results if r.method)),
        conditions=tuple(_conditions(calibration)),
        warnings=tuple(_warnings(calibration)),
        remarks=(*_alike(calibration), *(f"{r.channel}, {r.title}: {_remarks(r)}" for r in _remarked(calibration))),
        missing=tuple((r.channel, r.title, _remarks(r)) for r in calibration.results if not r.determined),
        program=_program(calibration.program),
    )


def _issued(calibration: Calibration, issuer: Issuer | None) -> dict[str, Any]:
    """What the laboratory's file says, and what nobody states."""
    controlled = f"{'records imported into' if _imported(calibration) else 'bench controlled by'} the program below"
    if issuer is None:
        nobody = dict.fromkeys(("customer", "order", "place"), NOT_STATED)
        return {**nobody, "laboratory": f"{NOT_STATED}; {controlled}", "issued": "", "signatories": ()}
    where = {"laboratory": "in the laboratory", "customer": "at the customer's", "other": "elsewhere"}
    texts = {
        "laboratory": issuer.laboratory.words, "customer": issuer.customer.words if issuer.customer else NOT_STATED,
        "order": issuer.order or NOT_STATED, "place": where[issuer.place],
    }  # fmt: skip
    return {
        **{name: printable(flat(text), f"certificate: {name}") for name, text in texts.items()},
        "issued": issuer.issued.isoformat() if issuer.issued else "",
        "signatories": tuple((flat(one.name), flat(one.role)) for one in issuer.signatories),
    }


def _imported(calibration: Calibration) -> bool:
    """Whether somebody else measured: the program only read the records."""
    return any(source.procedure == "import" for source in calibration.sources)


def identifier(calibration: Calibration, issuer: Issuer | None = None) -> str:
    """Name and a digest of what is said: two certificates that differ in a number or a customer differ in this."""
    content = (
        calibration.name, calibration.sensor, calibration.serial, calibration.made, calibration.simulated,
        [(s.run, s.digest) for s in calibration.sources],
        [(r.key, r.value, r.u, r.verdict, r.remarks) for r in calibration.results],
        calibration.overdue, calibration.flags, calibration.model, *([] if issuer is None else [issuer.model_dump()]),
    )  # fmt: skip
    return f"{calibration.name}-{hashlib.sha256(repr(content).encode('utf-8', 'replace')).hexdigest()[:12]}"


def printable(text: str, where: str) -> str:
    """The text itself; raises BadInput if it is empty, has blanks at its ends or characters that XML cannot hold."""
    if not text or text != text.strip():
        raise BadInput(f"{where}: found {text!r}, wanted a text without blanks at its ends")
    if any(not _legal(c) for c in text):
        raise BadInput(f"{where}: found {text!r}, wanted no control characters")
    return text


def flat(text: str) -> str:
    """The text on one line: line breaks and runs of blanks become one blank."""
    return " ".join(text.split())


def _remarks(result: Result) -> str:
    return "; ".join(printable(flat(remark), f"certificate: remark on {result.key}") for remark in result.remarks)


def _legal(c: str) -> bool:
    code = ord(c)
    return 0x20 <= code < 0x7F or 0xA0 <= code < 0xD800 or 0xE000 <= code < 0xFFFE or code >= 0x10000


def budgeted(calibration: Calibration) -> list[Result]:
    """Results whose budgets are printed: all that are judged, and a sensitivity of every kind; else the first."""
    able = [result for result in calibration.results if result.determined and result.budget is not None]
    chosen: dict[str, Result] = {}
    for result in able:
        if result.measurand in (COMBINED, "sensitivity"):
            chosen.setdefault(result.unit, result)
    return [one for one in able if one.verdict is not None or one in chosen.values()] or able[:1]


def rows(results: Iterable[Result]) -> dict[str, dict[str, Result]]:
    """Determined results by channel and measurand."""
    found: dict[str, dict[str, Result]] = {}
    for result in results:
        if result.determined:
            found.setdefault(result.channel, {})[result.measurand] = result
    return found


def limits(result: Result) -> str:
    """The limits in the unit on paper, "" without any."""
    unit, factor = SHOWN.get(result.unit, (result.unit, 1.0))
    low, high = ("" if side is None else f"{side * factor:.5g}" for side in (result.low, result.high))
    if low and high:
        return f"{low} … {high} {unit}"
    return f"≥ {low} {unit}" if low else f"≤ {high} {unit}" if high else ""


def printed(result: Result) -> tuple[str, str, str]:
    """Value, expanded uncertainty and unit as text."""
    value, expanded, unit = shown(result)
    return (*rounded(value, expanded), unit)


def standard_rows(calibration: Calibration) -> list[dict[str, str]]:
    """The standards, one mapping of texts each; `overdue` is "yes" for one used past its due date."""
    return [
        {name: str(standard.get(name, "not stated")) for name in ("instrument", "serial", "laboratory", "certificate")}
        | {"name": str(standard.get("standard", "standard")), "due": str(standard.get("due", "not stated"))}
        | {"calibrated": str(standard.get("calibrated", "not stated"))}
        | {"overdue": "yes" if standard.get("standard") in calibration.overdue else ""}
        | {"values": "; ".join(_stated(name, v) for name, v in dict(standard.get("values", {})).items())}
        for standard in calibration.standards
    ]


def _stated(name: str, value: Mapping[str, Any]) -> str:
    stated = f"{name} {value['value']}, U = {value['expanded_uncertainty']}"
    return f"{stated} (k = {value.get('coverage_factor', 2.0):g})"


def _conditions(calibration: Calibration) -> Iterable[tuple[str, str]]:
    for name, (mean, low, high) in calibration.conditions.items():
        unit, digits = ("°C", 1) if name == "temperature" else ("V", 3) if name == "supply" else ("", 3)
        yield name, f"{mean:.{digits}f} {unit} ({low:.{digits}f} {unit} to {high:.{digits}f} {unit})"


def _warnings(calibration: Calibration) -> Iterable[str]:
    if calibration.simulated:
        yield SIMULATED
    if calibration.overdue:
        yield f"Standards used past their due date by explicit order: {', '.join(calibration.overdue)}."
    yield from (printable(flat(flag), "certificate: remark") for flag in calibration.flags)


def _alike(calibration: Calibration) -> Iterable[str]:
    """Channels whose wires no measurement on these benches can tell apart."""
    groups = [] if _imported(calibration) else [" and ".join(names) for names in like_sensors(calibration)]
    if groups:
        yield f"Taken from the cable table, as no measurement here tells like sensors apart: {'; '.join(groups)}"


def _remarked(calibration: Calibration) -> Iterable[Result]:
    return (r for r in calibration.results if r.determined and r.remarks)


def _program(program: Mapping[str, str]) -> str:
    named = f"{program.get('name', 'rig')} {program.get('version', 'of a version not stated')}"
    others = [f"{name} {_short(value)}" for name, value in program.items() if name not in ("name", "version")]
    return ", ".join([named, *others])


def _short(value: str) -> str:
    """A digest by its first digits: enough to tell two apart, and fits in a line."""
    return value if len(value) <= 32 else f"{value[:16]}…"


def _date(time: float) -> str:
    return dt.datetime.fromtimestamp(time, dt.UTC).date().isoformat()
