"""The two forms of the certificate: what they say, that they say it twice alike, and that other programs read it."""

from __future__ import annotations

import datetime as dt
import importlib
import math
import os
import re
import sys
import types
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from example_calibration import example

from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Calibration, not_determined
from rig.certificate.dcc import DCC, MANY, OF_FREEDOM, write_dcc, xml
from rig.certificate.document import identifier, standard_rows
from rig.certificate.issuer import Issuer
from rig.certificate.pdf import compiled, write_pdf, written
from rig.errors import BadInput, ConfigError
from rig.yaml import config

SHARED = Path(os.environ.get("RIG_SHARED", Path(__file__).resolve().parents[2].parent / "shared"))
SVG = (
    b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 10" width="20" height="10">'
    b'<path d="M0 9L20 1" stroke="#000"/></svg>'
)
AWKWARD = "A<b>&\"7' #strong[x] $x$ *y* _z_ @me \\ //"
PRODUCERS_ESCAPES = {b"n": 10, b"r": 13, b"t": 9, b"b": 8, b"f": 12}


def pages(pdf: bytes) -> int:
    return len(re.findall(rb"/Type/Page(?!s)", pdf))


def text(pdf: bytes) -> str:
    """All text of the pages without blanks, read through each font's own table of characters."""
    objects = {int(n): body for n, body in re.findall(rb"(?s)(\d+) 0 obj(.*?)\nendobj", pdf)}
    fonts = {
        name: _characters(_stream(objects[int(re.search(rb"/ToUnicode (\d+)", objects[int(place)])[1])]))  # type: ignore[index]
        for body in objects.values()
        for resources in re.findall(rb"/Font<<(.*?)>>", body.split(b"stream")[0])
        for name, place in re.findall(rb"/(f\d+) (\d+) 0 R", resources)
    }
    contents = [int(n) for n in re.findall(rb"/Contents (\d+) 0 R", pdf)]
    found = "".join(part for place in contents for part in _shown(_stream(objects[place]), fonts))
    return "".join(found.split())


def _stream(body: bytes) -> bytes:
    return zlib.decompressobj().decompress(body.split(b"stream", 1)[1].lstrip(b"\r\n"))


def _characters(table: bytes) -> dict[int, str]:
    pairs = re.findall(rb"<([0-9A-F]{4})> <([0-9A-F]+)>", table.split(b"beginbfchar", 1)[1])
    return {int(code, 16): bytes.fromhex(to.decode()).decode("utf-16-be") for code, to in pairs}


def _shown(content: bytes, fonts: dict[bytes, dict[int, str]]) -> Iterator[str]:
    font: dict[int, str] = {}
    for name, literal in re.findall(rb"(?s)/(f\d+) [\d.]+ Tf|\(((?:\\.|[^\\)])*)\)", content):
        if name:
            font = fonts[name]
            continue
        raw = re.sub(rb"(?s)\\([0-7]{1,3}|.)", _unescaped, literal)
        yield "".join(font.get(raw[i] << 8 | raw[i + 1], "?") for i in range(0, len(raw) - 1, 2))


def _unescaped(match: re.Match[bytes]) -> bytes:
    code = match[1]
    return bytes([int(code, 8) & 255]) if code.isdigit() else bytes([PRODUCERS_ESCAPES.get(code, code[0])])


def says(calibration: Calibration, wanted: str) -> bool:
    return "".join(wanted.split()) in text(compiled(calibration))


def only_gyros() -> Calibration:
    return replace(example(), results=tuple(r for r in example().results if "gyro" in r.channel), responses={})


def only_accelerometers() -> Calibration:
    return replace(example(), results=tuple(r for r in example().results if r.channel.startswith("unit")))


def bare() -> Calibration:
    """One result, nothing else known."""
    one = example().results[:1]
    return replace(
        example(), results=one, responses={}, standards=(), conditions={}, sources=(), paper=(), flags=(), program={}
    )


def nothing_found() -> Calibration:
    return replace(bare(), results=(not_determined("x", "offset", "offset", "V", "no static record"),))


def awkward() -> Calibration:
    first, *others = example().results
    return replace(
        example(), serial=AWKWARD, results=(replace(first, remarks=(f"{AWKWARD}\nsecond\r\n line",)), *others)
    )


def crowded() -> Calibration:
    """What a long campaign gives: fifteen channels, all with a dozen measurands, many runs and remarks."""
    more = tuple(
        replace(r, measurand=f"further_{i}", title=f"further quantity {i}", remarks=(f"remark {r.channel} {i % 3}",))
        for r in example().results
        if r.measurand == "nonlinearity"
        for i in range(6)
    )
    runs = tuple(replace(example().sources[0], run=f"20261118-run-{i}") for i in range(12))
    return replace(example(), results=example().results + more, sources=runs, overdue=("encoder", "vibrometer"))


EDGES = {f.__name__: f() for f in (example, only_gyros, only_accelerometers, bare, nothing_found, awkward, crowded)}


@pytest.fixture(scope="module")
def printed_text() -> str:
    return text(compiled(example()))


@pytest.mark.parametrize("calibration", EDGES.values(), ids=EDGES)
def test_the_certificate_has_one_to_three_pages_before_its_annex(calibration: Calibration) -> None:
    content = compiled(calibration)
    before, annex, _ = text(content).partition("Annex:uncertaintybudgets")
    ended = len(re.findall(r"Page\d+of\d+", before)) if annex else pages(content)
    assert 1 <= ended <= 3
    assert bool(annex) == any(one.budget is not None for one in calibration.results)


def test_the_paper_states_item_dates_methods_conditions_and_coverage(printed_text: str) -> None:
    for wanted in (
        "Calibration certificate", "Sensor Cube", "SIM-CUBE-1", "Page1of3", "2026-11-18", "static record",
        "sine approximation against the vibrometer", "23.2 °C (22.1 °C to 25.0 °C)", "coverage probability of 95 %",
        "guard band w = U", "rig 0.1.0", "The sweeps cover one mounting only",
    ):  # fmt: skip
        assert "".join(wanted.split()) in printed_text, wanted


def test_every_standard_is_printed_with_certificate_and_due_date(printed_text: str) -> None:
    for row in standard_rows(example()):
        for wanted in (row["certificate"], row["due"], row["serial"], row["laboratory"]):
            assert "".join(wanted.split()) in printed_text, wanted


def test_every_determined_result_is_printed_with_its_uncertainty(printed_text: str) -> None:
    from rig.certificate.document import printed

    for result in example().results:
        if result.determined:
            value, expanded, _ = printed(result)
            assert f"{value.replace('-', '−')}±{expanded}" in printed_text, result.key


def test_every_verdict_is_printed_behind_its_result(printed_text: str) -> None:
    for result in example().results:
        if result.verdict is not None:
            assert re.search(f"{result.channel},{result.title}[^a-z]*(mV/g)[^a-z]*mV/g{result.verdict}", printed_text)


def test_the_budget_of_a_sensitivity_is_printed_line_by_line(printed_text: str) -> None:
    for key in ("unit_a_x.sensitivity", "gyro_pitch.sensitivity"):
        budget = example().result(key).budget
        assert budget is not None
        for one in budget.contributions:
            line = f"{one.name}({one.source}){one.kind}{one.distribution}"
            assert "".join(line.split()) in printed_text, line
            assert f"{100 * budget.shares()[one.name]:.1f}" in printed_text


def test_contributions_of_the_budget_are_in_the_unit_of_the_printed_result(printed_text: str) -> None:
    gain = example().result("unit_a_x.sensitivity").contributions[0]
    in_mv_per_g = gain.contribution * 1e3 * 9.80665
    assert f"{gain.u:.3g}{gain.sensitivity:.4g}{in_mv_per_g:.3g}83.3" in printed_text


def test_a_coverage_factor_that_differs_between_channels_is_printed_behind_each_result() -> None:
    first, second = (example().result(f"unit_a_{axis}.sensitivity") for axis in "xy")
    assert second.value is not None
    few = Budget((Contribution("scatter", "A", "t", 0.001 * second.value, second.unit, 1.0, dof=4),))
    found = text(compiled(replace(bare(), results=(first, replace(second, budget=few)))))
    assert "±6.9(1.96)" in found
    assert "(2.78)" in found


def test_what_was_not_determined_is_printed_with_its_reason(printed_text: str) -> None:
    missing = next(r for r in example().results if not r.determined)
    assert "".join(f"{missing.remarks[0]} ({missing.title} of {missing.channel})".split()) in printed_text


def test_one_remark_of_many_channels_is_printed_once_and_names_them() -> None:
    remarked = tuple(
        replace(r, remarks=("supply unsteady",)) if r.measurand == "offset" else r for r in example().results
    )
    found = text(compiled(replace(example(), results=remarked)))
    assert found.count("supplyunsteady") == 1
    assert "offsetofunit_a_x,unit_a_y," in found


@pytest.mark.parametrize("simulated", [True, False])
def test_simulated_is_printed_if_and_only_if_the_bench_was(simulated: bool) -> None:
    made = text(compiled(replace(bare(), simulated=simulated)))
    assert ("SIMULATED" in made) is simulated
    assert (b"SIMULATED" in xml(replace(bare(), simulated=simulated))) is simulated


def test_simulated_stands_in_the_header_and_across_each_page() -> None:
    made = compiled(example())
    assert text(made).count("SIMULATED") >= 2 * pages(made)


def test_a_standard_used_past_its_due_date_is_named_in_both_forms() -> None:
    late = replace(example(), overdue=("vibrometer",))
    assert says(late, "past their due date, by explicit order: vibrometer (EX-LDV-2026-014, due 2027-03-02)")
    assert b"PAST ITS DUE DATE" in xml(late)
    assert not says(example(), "past their due date")


def test_the_same_calibration_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one.pdf", "two.pdf"):
        write_pdf(example(), tmp_path / name, {"response": SVG})
    assert (tmp_path / "one.pdf").read_bytes() == (tmp_path / "two.pdf").read_bytes()
    assert xml(example()) == xml(example())


def test_the_paper_bears_the_time_of_the_newest_record_and_not_that_of_its_making() -> None:
    made = dt.datetime.fromtimestamp(example().made, dt.UTC).isoformat()
    assert f"<xmp:CreateDate>{made}</xmp:CreateDate>".encode() in compiled(example())


def test_a_flagged_result_is_marked_in_both_forms(printed_text: str) -> None:
    flagged = next(r for r in example().results if r.status == "flagged")
    assert "".join(f"Flagged: {flagged.remarks[0]} ({flagged.title} of {flagged.channel})".split()) in printed_text
    assert xml(example()).count(b">flagged<") == 1
    assert printed_text.count("Flagged:") == 1


def test_another_number_gives_another_identification() -> None:
    first, *others = example().results
    assert first.value is not None
    changed = replace(example(), results=(replace(first, value=first.value * 1.001), *others))
    assert compiled(changed) != compiled(example())


def test_markup_in_a_serial_or_a_remark_is_printed_as_it_stands() -> None:
    assert says(awkward(), AWKWARD)
    assert says(awkward(), f"{AWKWARD} second line")


def test_a_figure_is_printed_with_its_name_and_anything_but_svg_is_refused() -> None:
    with_figure = compiled(bare(), {"Response of unit_a_x": SVG})
    assert "Responseofunit_a_x" in text(with_figure)
    with pytest.raises(BadInput, match="no SVG"):
        compiled(bare(), {"broken": b"\x89PNG"})
    with pytest.raises(BadInput, match="cannot be typeset"):
        compiled(bare(), {"broken": b"<svg"})


@pytest.mark.parametrize("form", [compiled, xml])
def test_a_text_that_cannot_be_printed_is_refused(form: Any) -> None:
    for bad in ("", " x", "a\x00b", "a\nb"):
        with pytest.raises(BadInput, match="serial"):
            form(replace(bare(), serial=bad))
    with pytest.raises(BadInput, match="remark"):
        form(replace(bare(), flags=("bell \x07",)))
    with pytest.raises(BadInput, match="no results"):
        form(replace(bare(), results=()))


def test_control_characters_in_a_release_or_a_model_are_refused() -> None:
    with pytest.raises(BadInput, match="release"):
        xml(replace(bare(), program={"version": "1\x02"}))
    standard = {**example().standards[0], "instrument": "OFV\x02"}
    with pytest.raises(BadInput, match="model"):
        xml(replace(bare(), standards=(standard,)))


@pytest.fixture(scope="module")
def schema() -> Any:
    from lxml import etree

    path = SHARED / "dcc" / "dcc.xsd"
    if not path.is_file():
        pytest.skip(f"found no {path}: set RIG_SHARED to the folder with dcc/dcc.xsd to validate certificates")
    return etree.XMLSchema(etree.parse(str(path), etree.XMLParser(no_network=True)))


@pytest.mark.parametrize("calibration", EDGES.values(), ids=EDGES)
def test_the_digital_certificate_validates(schema: Any, calibration: Calibration) -> None:
    from lxml import etree

    issuer = example_issuer().model_copy(update={"issued": dt.date(2026, 12, 1)})
    for case in (calibration, replace(calibration, simulated=False, overdue=("vibrometer",))):
        for stated in (None, issuer, issuer.model_copy(update={"customer": None, "signatories": ()})):
            assert schema.validate(etree.fromstring(xml(case, stated))), schema.error_log


def _without_signatures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pydcc be imported where its signature check cannot be: oscrypto 1.3 does not know OpenSSL 3.0.10 and later.

    Our certificates are not signed; reading values uses nothing of it.
    """
    from oscrypto.errors import LibraryNotFoundError

    try:
        importlib.import_module("certvalidator")
    except LibraryNotFoundError:
        absent = types.ModuleType("certvalidator")
        for name in ("CertificateValidator", "ValidationContext", "errors"):
            setattr(absent, name, None)
        monkeypatch.setitem(sys.modules, "certvalidator", absent)


@pytest.fixture
def offline_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home with pydcc's workspace, so that it has nothing to fetch."""
    (tmp_path / "pydcc").mkdir()
    (tmp_path / "pydcc" / "Readme.txt").write_text("schemas are not needed to read values\n")
    (tmp_path / "pydcc" / "data.json").write_text(
        '{"online_available_releases": {"description": "", "releases": []}, "local_available_schemas": [], '
        '"last_update": "2026-01-01T00:00:00"}'
    )
    monkeypatch.setenv("HOME", str(tmp_path))
    _without_signatures(monkeypatch)
    return tmp_path


@pytest.mark.parametrize("calibration", EDGES.values(), ids=EDGES)
def test_pydcc_reads_the_same_values_and_uncertainties_back(offline_home: Path, calibration: Calibration) -> None:
    from dcc.dcc import DCC

    path = offline_home / "certificate.xml"
    write_dcc(calibration, path)
    read = DCC(str(path))
    reals = {row["real"]["label"]: row["real"] for _, row in read.get_calibration_results("name") if "real" in row}
    freedom = {label: reals.pop(label) for label in list(reals) if label.endswith(OF_FREEDOM)}
    judged = [result for result in calibration.results if result.determined and result.verdict is not None]
    assert all(float(freedom[f"{one.key}{OF_FREEDOM}"]["value"]) == min(one.dof, MANY) for one in judged)
    determined = [result for result in calibration.results if result.determined]
    assert len(reals) == len(determined)
    for result in determined:
        real = reals[result.key]
        assert float(real["value"]) == result.value
        assert float(real["expandedUnc"]["uncertainty"]) == result.expanded
        assert float(real["expandedUnc"]["coverageFactor"]) == result.coverage_factor
        assert float(real["expandedUnc"]["coverageProbability"]) == 0.95


def test_pydcc_reads_the_frequency_response_back(offline_home: Path) -> None:
    from dcc.dcc import DCC

    path = offline_home / "certificate.xml"
    write_dcc(example(), path)
    rows = [row["realListXMLList"] for _, row in DCC(str(path)).get_calibration_results("name") if "real" not in row]
    points = [point for point in example().responses["unit_a_x"] if point.level == "full"]
    assert [float(x) for x in rows[0]["valueXMLList"].split()] == [point.frequency for point in points]
    assert [float(x) for x in rows[1]["valueXMLList"].split()] == [point.magnitude for point in points]


def test_a_number_that_is_not_finite_or_a_unit_unknown_to_si_is_refused() -> None:
    one = example().results[0]
    with pytest.raises(BadInput, match="finite"):
        xml(replace(bare(), results=(replace(one, value=float("inf")),)))
    with pytest.raises(BadInput, match="furlong"):
        xml(replace(bare(), results=(replace(one, unit="furlong"),)))


def example_issuer() -> Issuer:
    return config.load(Path(__file__).parents[2] / "configs" / "laboratories" / "example.yaml", Issuer)


def test_laboratory_customer_order_and_signatories_are_printed() -> None:
    issuer = example_issuer()
    said = text(compiled(example(), issuer=issuer))
    assert issuer.customer is not None
    for wanted in (
        issuer.laboratory.name, issuer.laboratory.code, issuer.laboratory.address, issuer.customer.name, issuer.order,
        *(one.name for one in issuer.signatories), *(one.role for one in issuer.signatories),
    ):  # fmt: skip
        assert wanted is not None
        assert "".join(wanted.split()) in said, wanted
    assert "notstated" not in said.partition("Methods")[0]


def test_laboratory_customer_order_and_signatories_are_in_the_digital_certificate() -> None:
    issuer = example_issuer()
    found = xml(example(), issuer.model_copy(update={"issued": dt.date(2026, 12, 1)}))
    root = ET.fromstring(found)
    data = "dcc:administrativeData/dcc:"

    def said(path: str) -> list[str | None]:
        return [one.text for one in root.findall(data + path, {"dcc": DCC})]

    assert said("coreData/dcc:countryCodeISO3166_1") == ["DE"]
    assert said("coreData/dcc:identifications/dcc:identification/dcc:value") == [issuer.order]
    assert said("coreData/dcc:issueDate") == ["2026-12-01"]
    assert said("calibrationLaboratory/dcc:calibrationLaboratoryCode") == ["EX-D-00000"]
    assert said("customer/dcc:name/dcc:content") == ["Example Robotics"]
    assert said("customer/dcc:location/dcc:countryCode") == ["FR"]
    assert said("respPersons/dcc:respPerson/dcc:mainSigner") == ["true", "false"]
    assert said("respPersons/dcc:respPerson/dcc:role") == ["head of laboratory", "technician"]


def test_another_customer_gives_another_identification() -> None:
    issuer = example_issuer()
    others = [identifier(example()), identifier(example(), issuer)]
    others.append(identifier(example(), issuer.model_copy(update={"customer": None})))
    assert len(set(others)) == 3


def test_mistakes_in_a_laboratorys_file_are_named_where_they_stand(tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text("laboratory: {name: L, country: Germany}\nsigned: no\n")
    with pytest.raises(ConfigError) as caught:
        config.load(tmp_path / "lab.yaml", Issuer)
    assert {(p.line, p.key) for p in caught.value.problems} == {(1, "laboratory.country"), (2, "signed")}


def test_the_digital_certificate_has_the_budget_of_every_judged_result() -> None:
    found = xml(example())
    names, space = [], {"dcc": DCC, "si": "https://ptb.de/si"}
    for one in ET.fromstring(found).iterfind(".//dcc:result[@refType='rig_uncertaintyBudget']", space):
        key = str(one.findtext("dcc:name/dcc:content", "", space)).removeprefix("Uncertainty budget of ")
        result = example().result(key)
        shares = one.findtext(
            ".//dcc:quantity[@refType='rig_contributionToStandardUncertainty']//si:valueXMLList", "", space
        ).split()
        assert math.hypot(*map(float, shares)) == pytest.approx(result.u)
        listed = one.findtext(".//dcc:quantity[@refType='rig_contribution']/dcc:charsXMLList", "", space)
        assert len(listed.split()) == len(shares) == len(result.contributions)
        names.append(key)
    assert {r.key for r in example().results if r.verdict is not None and r.determined} <= set(names)


@pytest.mark.parametrize(("number", "said"), [
    (6.2e-5, "6.2 × 10⁻⁵"), (0.0, "0"), (-1.5e-7, "−1.5 × 10⁻⁷"), (0.0123456, "0.0123"), (3e12, "3 × 10¹²"),
])  # fmt: skip
def test_numbers_are_written_as_people_write_them(number: float, said: str) -> None:
    assert written(number) == said
