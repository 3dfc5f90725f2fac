"""The digital calibration certificate: DCC 3.2.1 XML (PTB) with values in D-SI."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from rig.archive.durable import write_whole
from rig.calibrate.budget import coverage_factor
from rig.calibrate.calibration import PROBABILITY, Calibration, ResponsePoint, Result
from rig.certificate.document import COVERAGE, DECISION, Document, budgeted, document, flat, printable, standard_rows
from rig.errors import BadInput

if TYPE_CHECKING:
    from rig.certificate.issuer import Issuer, Party

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"

# SI unit: the same in D-SI
UNITS = {
    "V/(m/s²)": r"\volt\metre\tothe{-1}\second\tothe{2}",
    "V/(rad/s)": r"\volt\radian\tothe{-1}\second",
    "m/s²": r"\metre\second\tothe{-2}",
    "rad/s": r"\radian\second\tothe{-1}",
    "(m/s²)/√Hz": r"\metre\second\tothe{-1.5}",
    "(rad/s)/√Hz": r"\radian\second\tothe{-0.5}",
    "(m/s²)·√Hz": r"\metre\second\tothe{-2.5}",
    "(rad/s)·√Hz": r"\radian\second\tothe{-1.5}",
    "rad": r"\radian",
    "s": r"\second",
    "1": r"\one",
    "V": r"\volt",
    "Hz": r"\hertz",
    "1/(m/s²)": r"\metre\tothe{-1}\second\tothe{2}",
    "1/(rad/s)": r"\radian\tothe{-1}\second",
    "1/(rad/s)²": r"\radian\tothe{-2}\second\tothe{2}",
    "°C": r"\degreecelsius",
}
NAMES = {"m": "metre", "s": "second", "rad": "radian", "V": "volt", "Hz": "hertz", "K": "kelvin"}
POWERS = {"": Fraction(1), "²": Fraction(2), "³": Fraction(3)}
FACTOR = re.compile(r"([/·]?)(?:(√?[A-Za-z1]+)|\(([^()]*)\))([²³]?)")
CONDITIONS = {"temperature": ("°C", "basic_temperature"), "supply": ("V", "rig_supplyVoltage")}
NORMAL = 1.96  # k of the normal law at 95 %, to the digits that are read
OF_FREEDOM = ".degrees_of_freedom"  # behind a result's key
MANY = 1e9  # degrees of freedom that stand for no limit: the schema takes no infinity


def write_dcc(calibration: Calibration, path: Path, issuer: Issuer | None = None) -> None:
    """Write the certificate; raises BadInput for a unit without a D-SI form or a number that is not finite.

    Value and expanded uncertainty are in SI, unrounded. Without an `issuer` the names of laboratory and customer are
    not known and say so.
    """
    write_whole(path, xml(calibration, issuer))


def xml(calibration: Calibration, issuer: Issuer | None = None) -> bytes:
    """The certificate as XML in UTF-8."""
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    words = document(calibration, issuer)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion="3.2.1")
    _administration(_add(root, "administrativeData"), words, calibration, issuer)
    _measurement(_add(_add(root, "measurementResults"), "measurementResult"), words, calibration)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True))


def _add(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    child = ET.SubElement(parent, f"{{{DCC}}}{tag}", attributes)
    child.text = text
    return child


def _si(parent: ET.Element, tag: str, text: str | None = None) -> ET.Element:
    child = ET.SubElement(parent, f"{{{SI}}}{tag}")
    child.text = text
    return child


def _text(parent: ET.Element, tag: str, *texts: str, **attributes: str) -> ET.Element:
    child = _add(parent, tag, **attributes)
    for text in texts:
        _add(child, "content", printable(flat(text), f"digital certificate: {tag}"), lang="en")
    return child


def _administration(data: ET.Element, words: Document, calibration: Calibration, issuer: Issuer | None) -> None:
    software = _add(_add(data, "dccSoftware"), "software")
    _text(software, "name", calibration.program.get("name", "rig"))
    release = calibration.program.get("version", "not stated")
    _add(software, "release", printable(release, "digital certificate: release"))
    _own_words(_add(data, "refTypeDefinitions"), release)
    _core(_add(data, "coreData"), words, issuer)
    item = _add(_add(data, "items"), "item")
    _text(item, "name", words.sensor)
    _identification(item, "manufacturer", words.serial, "Serial number", "basic_serialNumber")
    laboratory = _add(data, "calibrationLaboratory")
    if issuer is not None and issuer.laboratory.code:
        _add(laboratory, "calibrationLaboratoryCode", flat(issuer.laboratory.code))
    _contact(_add(laboratory, "contact"), "Laboratory not stated", None if issuer is None else issuer.laboratory)
    persons = _add(data, "respPersons")
    for place, (name, role) in enumerate(words.signatories or (("Not signed", ""),)):
        person = _add(persons, "respPerson")
        _text(_add(person, "person"), "name", name)
        if role:
            _add(person, "role", role)
        _add(person, "mainSigner", "true" if place == 0 else "false")
    _contact(_add(data, "customer"), "Customer not stated", None if issuer is None else issuer.customer)
    _statements(_add(data, "statements"), words)


def _own_words(definitions: ET.Element, release: str) -> None:
    """The namespace of what the public vocabularies have no word for."""
    one = _add(definitions, "refTypeDefinition")
    _text(one, "name", "rig")
    _text(one, "description", "Measurands as the program's reference page `measurands` defines them")
    for tag, text in (("namespace", "rig"), ("link", "docs/reference/measurands.md"), ("release", release)):
        _add(one, tag, text)


def _core(core: ET.Element, words: Document, issuer: Issuer | None) -> None:
    _add(core, "countryCodeISO3166_1", (issuer and issuer.laboratory.country) or "ZZ")  # user-assigned: not known
    _add(core, "usedLangCodeISO639_1", "en")
    _add(core, "mandatoryLangCodeISO639_1", "en")
    _add(core, "uniqueIdentifier", words.identifier)
    if issuer is not None and issuer.order:
        _identification(core, "calibrationLaboratory", words.order, "Order number", "basic_orderNumber")
    _add(core, "beginPerformanceDate", words.begun)
    _add(core, "endPerformanceDate", words.ended)
    _add(core, "performanceLocation", issuer.place if issuer is not None else "laboratory")
    if words.issued:
        _add(core, "issueDate", words.issued)


def _identification(parent: ET.Element, issuer: str, value: str, name: str, kind: str) -> None:
    one = _add(_add(parent, "identifications"), "identification", refType=kind)
    _add(one, "issuer", issuer)
    _add(one, "value", printable(value, f"digital certificate: {name}"))
    _text(one, "name", name)


def _contact(contact: ET.Element, unknown: str, party: Party | None) -> None:
    _text(contact, "name", unknown if party is None else party.name)
    if party is not None and party.email:
        _add(contact, "eMail", flat(party.email))
    location = _add(contact, "location")
    if party is not None and party.country:
        _add(location, "countryCode", party.country)
    _text(location, "further", (party and party.address) or "not stated")


def _statements(parent: ET.Element, words: Document) -> None:
    for name, text in (("Uncertainty", COVERAGE), ("Decision rule", DECISION)):
        _statement(parent, name, text)
    if words.model:
        _statement(parent, "Model", f"The values stand on a model fitted to the records: {words.model}.")
    if words.agreement:
        _statement(parent, "Direct estimates beside the fit", f"{words.agreement}.")
    for warning in words.warnings:
        _statement(parent, "SIMULATED" if warning.startswith("SIMULATED") else "Warning", warning)
    for remark in words.remarks:
        _statement(parent, "Remark", remark)


def _statement(parent: ET.Element, name: str, text: str) -> None:
    one = _add(parent, "statement")
    _text(one, "name", name)
    _text(one, "declaration", text)


def _measurement(measured: ET.Element, words: Document, calibration: Calibration) -> None:
    _text(measured, "name", f"Calibration of {words.sensor}")
    methods = _add(measured, "usedMethods")
    for method in words.methods or ("not stated",):
        _text(_add(methods, "usedMethod"), "name", method)
    _equipment(measured, calibration)
    _influences(measured, calibration)
    results = _add(measured, "results")
    for measurand in dict.fromkeys(r.measurand for r in calibration.results):
        _group(results, measurand, [r for r in calibration.results if r.measurand == measurand])
    for channel, points in calibration.responses.items():
        if points:
            _response(results, channel, points)
    for result in budgeted(calibration):
        _budget(results, result)


def _budget(results: ET.Element, result: Result) -> None:
    """The budget of a judged result: names, and columns of numbers beside them."""
    one = _add(results, "result", refType="rig_uncertaintyBudget")
    _text(one, "name", f"Uncertainty budget of {result.key}")
    k = f"{result.coverage_factor:.4g}"
    said = f"effective degrees of freedom {result.dof:.4g}, k = {k} for {PROBABILITY:.0%} (JCGM 100:2008 G.4)"
    _text(one, "description", said)
    data, lines = _add(one, "data"), result.contributions
    rows = _add(data, "list", refType="rig_uncertaintyBudget")
    for name, texts in (
        ("Contribution", [line.name for line in lines]), ("Type", [line.kind for line in lines]),
        ("Distribution", [line.distribution for line in lines]), ("Source", [line.source or "-" for line in lines]),
    ):  # fmt: skip
        quantity = _add(rows, "quantity", refType=f"rig_{name.lower()}")
        _text(quantity, "name", name)
        words = (re.sub(r"\s+", "_", printable(flat(text), f"digital certificate: {name}")) for text in texts)
        _add(quantity, "charsXMLList", " ".join(words))
    _series(rows, "Degrees of freedom", "rig_degreesOfFreedom", (min(line.dof, MANY) for line in lines), "1")
    _series(rows, "Contribution", "rig_contributionToStandardUncertainty",
            (line.contribution for line in lines), result.unit)  # fmt: skip
    quantity = _add(data, "quantity", refType="rig_effectiveDegreesOfFreedom")
    _text(quantity, "name", "Effective degrees of freedom")
    real = _si(quantity, "real")
    _si(real, "label", f"{result.key}{OF_FREEDOM}")
    _si(real, "value", _number(min(result.dof, MANY), result.key))
    _si(real, "unit", _unit("1"))


def _equipment(measured: ET.Element, calibration: Calibration) -> None:
    if not calibration.standards:
        return
    parent = _add(measured, "measuringEquipments")
    for row in standard_rows(calibration):
        one = _add(parent, "measuringEquipment", refType="basic_measurementStandard")
        _text(one, "name", row["name"])
        overdue = " USED PAST ITS DUE DATE BY EXPLICIT ORDER." if row["overdue"] else ""
        dates = f"calibrated {row['calibrated']}, due {row['due']}"
        stated = f"Certificate {row['certificate']} of {row['laboratory']}, {dates}. {row['values']}".rstrip()
        _text(one, "description", stated + overdue)
        _add(one, "model", printable(row["instrument"], "digital certificate: model"))
        _identification(one, "manufacturer", row["serial"], "Serial number", "basic_serialNumber")


def _influences(measured: ET.Element, calibration: Calibration) -> None:
    known = [(name, values) for name, values in calibration.conditions.items() if name in CONDITIONS]
    if not known:
        return
    parent = _add(measured, "influenceConditions")
    for name, values in known:
        unit, kind = CONDITIONS[name]
        one = _add(parent, "influenceCondition", refType=kind)
        _text(one, "name", name)
        data = _add(one, "data")
        for label, value in zip(("mean", "minimum", "maximum"), values, strict=True):
            quantity = _add(data, "quantity")
            _text(quantity, "name", label)
            real = _si(quantity, "real")
            _si(real, "value", _number(value, name))
            _si(real, "unit", _unit(unit))


def _group(results: ET.Element, measurand: str, group: Sequence[Result]) -> None:
    one = _add(results, "result", refType=f"rig_{measurand}")
    _text(one, "name", group[0].title)
    data = _add(one, "data")
    for result in group:
        if result.determined:
            _quantity(data, result)
        else:  # a text, because readers of quantities want a number in each
            _text(data, "text", f"{result.channel}: not determined: {'; '.join(result.remarks)}")


def _quantity(data: ET.Element, result: Result) -> None:
    quantity = _add(data, "quantity", refType="basic_measuredValue")
    _text(quantity, "name", result.channel)
    said = (*(("flagged",) if result.status == "flagged" else ()), *result.remarks)
    if said:
        _text(quantity, "description", *said)
    real = _si(quantity, "real")
    _si(real, "label", result.key)
    assert result.value is not None
    _si(real, "value", _number(result.value, result.key))
    _si(real, "unit", _unit(result.unit))
    if result.budget is not None:
        expanded = _si(real, "expandedUnc")
        _si(expanded, "uncertainty", _number(result.expanded, result.key))
        _si(expanded, "coverageFactor", _number(result.coverage_factor, result.key))
        _si(expanded, "coverageProbability", f"{PROBABILITY}")
        _si(expanded, "distribution", "normal" if round(result.coverage_factor, 2) == NORMAL else "t")
    if result.verdict is not None:
        meta = _add(_add(quantity, "measurementMetaData"), "metaData", refType="basic_conformity")
        _text(meta, "declaration", f"{result.ruling}, guard band w = U")
        _add(meta, "conformity", _conformity(result))


def _conformity(result: Result) -> str:
    """Inconclusive is called conditional in the schema, pass or fail by the side on which the value itself lies."""
    if result.verdict != "inconclusive":
        return str(result.verdict)
    value = result.value if result.value is not None else math.nan
    low = -math.inf if result.low is None else result.low
    high = math.inf if result.high is None else result.high
    return "conditionalPass" if low <= value <= high else "conditionalFail"


def _response(results: ET.Element, channel: str, points: Sequence[ResponsePoint]) -> None:
    for level in dict.fromkeys(point.level for point in points):
        chosen = [point for point in points if point.level == level]
        one = _add(results, "result", refType="rig_frequencyResponse")
        _text(one, "name", f"Frequency response of {channel}, level {level}")
        rows = _add(_add(one, "data"), "list", refType="rig_frequencyResponse")
        _series(rows, "Frequency", "vib_frequency", (p.frequency for p in chosen), "Hz")
        _series(
            rows,
            "Magnitude",
            "rig_magnitude",
            (p.magnitude for p in chosen),
            "V/(m/s²)",
            [p.uc_magnitude for p in chosen],
        )
        _series(rows, "Phase", "rig_phase", (p.phase for p in chosen), "rad", [p.uc_phase for p in chosen])


def _series(
    rows: ET.Element, name: str, kind: str, values: Iterable[float], unit: str, uc: Sequence[float] | None = None
) -> None:
    quantity = _add(rows, "quantity", refType=kind)
    _text(quantity, "name", name)
    listed = _si(quantity, "realListXMLList")
    _si(listed, "valueXMLList", " ".join(_number(value, name) for value in values))
    _si(listed, "unitXMLList", _unit(unit))
    if uc is not None:
        k = coverage_factor(math.inf, PROBABILITY)
        expanded = _si(listed, "expandedUncXMLList")
        _si(expanded, "uncertaintyXMLList", " ".join(_number(k * u, name) for u in uc))
        _si(expanded, "coverageFactorXMLList", _number(k, name))
        _si(expanded, "coverageProbabilityXMLList", f"{PROBABILITY}")
        _si(expanded, "distributionXMLList", "normal")


def _number(value: float, where: str) -> str:
    if not math.isfinite(value):
        raise BadInput(f"digital certificate: {where}: found {value}, wanted a finite number")
    return repr(float(value))


def _unit(unit: str) -> str:
    if unit in UNITS:
        return UNITS[unit]
    powers: dict[str, Fraction] = {}
    if not _count(unit, Fraction(1), powers):
        wanted = f"a product of powers of {', '.join(NAMES)}"
        raise BadInput(f"digital certificate: found the unit '{unit}', wanted {wanted}")
    return "".join(_power(name, power) for name, power in powers.items() if power) or r"\one"


def _power(name: str, power: Fraction) -> str:
    return rf"\{name}" if power == 1 else rf"\{name}\tothe{{{float(power):g}}}"


def _count(text: str, sign: Fraction, powers: dict[str, Fraction]) -> bool:
    """Add up the powers of a unit such as `1/(m/s²)²` or `m/s²/√s`; whether all of it was understood."""
    for divided, name, inner, raised in FACTOR.findall(text):
        here = sign * (-1 if divided == "/" else 1) * POWERS[raised]
        if inner and not _count(inner, here, powers):
            return False
        if not inner and name != "1":
            bare = name.removeprefix("√")
            if bare not in NAMES:
                return False
            half = Fraction(1, 2) if name != bare else Fraction(1)
            powers[NAMES[bare]] = powers.get(NAMES[bare], Fraction(0)) + here * half
    return not FACTOR.sub("", text)
