"""The bench file: what it says, what is wrong with it and where, and standards past their date."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from rig.bench.benchfile import Standard, describe, filled
from rig.errors import ConfigError, StandardOverdue
from rig.yaml.config import load, shipped

SHIPPED = shipped("benches/simulated.yaml")
Change = Callable[..., Path]


@pytest.fixture
def changed(tmp_path: Path) -> Change:
    """A copy of the shipped configs with pieces of one file's text replaced; gives the bench file."""

    def change(*pairs: tuple[str, str], file: str = "benches/simulated.yaml") -> Path:
        root = SHIPPED.parents[1]
        for path in root.rglob("*.yaml"):
            copy = tmp_path / path.relative_to(root)
            copy.parent.mkdir(parents=True, exist_ok=True)
            text = path.read_text(encoding="utf-8")
            for old, new in pairs if str(path.relative_to(root)) == file else ():
                assert old in text, old
                text = text.replace(old, new, 1)
            copy.write_text(text, encoding="utf-8")
        return tmp_path / "benches" / "simulated.yaml"

    return change


def said(path: Path) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        describe(path)
    return [f"{Path(p.file).name}:{p.line}:{p.column} {p.key}: {p.text}" for p in caught.value.problems]


@pytest.mark.parametrize("name", ["simulated", "hardware"])
def test_shipped_benches_can_be_described_with_everything_they_name(name: str) -> None:
    description = describe(shipped(f"benches/{name}.yaml"))
    assert description.simulated == (name == "simulated")
    assert [standard.standard for standard in description.standards] == [
        "vibrometer",
        "encoder",
        "time_base",
        "gravity",
        "converter",
    ]
    assert len(description.sensor.channels) == 15
    assert all(len(names) == 16 for names in description.file.cables.values())


def test_a_bench_file_says_its_facts_in_si() -> None:
    facts = describe(SHIPPED).facts()
    assert facts.limits.acceleration == pytest.approx(0.5 * 9.80665)
    assert (facts.limits.stroke, facts.limits.velocity, facts.limits.source) == pytest.approx((1e-4, 0.1, 5.0))
    assert (facts.drive_constant, facts.scan_rate, facts.mains) == pytest.approx((20e-6, 3125.0, 50.0))
    assert (facts.full_stroke, facts.filter_cutoff) == pytest.approx((80e-6, 5000.0))
    assert facts.has >= {"analyzer", "vibrometer", "recorder", "filter", "turntable", "encoder", "scope", "cube"}


def test_simulated_and_hardware_differ_in_addresses_clock_operator_cube_and_what_is_known_of_them_only() -> None:
    simulated, hardware = (
        yaml.safe_load(shipped(f"benches/{name}.yaml").read_text()) for name in ("simulated", "hardware")
    )
    different = {key for key in simulated if simulated[key] != hardware.get(key)}
    assert different == {
        "bench", "simulated", "clock", "operator", "instruments", "sensors", "alignment", "influences"
    }  # fmt: skip
    assert set(simulated["influences"]) == set(hardware["influences"])
    for role, entry in simulated["instruments"].items():
        keys = {key for key in entry if entry[key] != hardware["instruments"][role].get(key)}
        assert keys <= {"address", "gateway", "serial"}


def test_every_mistake_of_a_bench_file_is_named_at_once_where_it_stands(changed: Change) -> None:
    path = changed(
        ("clock: bench", "clock: sundial"),
        ("rate: 3125 Hz", "rate: 3125"),
        ("stroke: 100 µm", "stroke: 100 s"),
        ("recorders: [recorder, analyzer, scope]", "recorders: []"),
        ("filter_cutoff", "filter_cutof"),
    )
    lines = said(path)
    keys = [line.split()[1].rstrip(":") for line in lines]
    assert keys == ["clock", "rate", "recorders", "limits.stroke", "filter_cutof"]
    assert all(": found " in line and ", wanted " in line for line in lines)
    text = path.read_text().splitlines()
    for line in lines:
        row, column = map(int, line.split()[0].split(":")[1:])
        assert text[row - 1][column - 1 :].split("#")[0].startswith(("sundial", "3125", "[]", "100 s", "filter_cutof"))


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("displacement_per_volt: 20 µm", "displacement_per_volt: 0 m", "shaker.displacement_per_volt"),
        ("acceleration: 0.5 g, stroke", "acceleration: -1 g, stroke", "limits.acceleration"),
        ("source: 5 Vpk", "source: 5 Vrms", "limits.source"),
        ("mains: 50 Hz", "mains: 0 Hz", "mains"),
        ("rate: 3125 Hz", "rate: 0 Hz", "rate"),
        ("seed: 1", "seed: -1", "simulated.seed"),
    ],
)
def test_a_value_that_cannot_be_is_refused_at_its_place(changed: Change, old: str, new: str, key: str) -> None:
    (line,) = said(changed((old, new)))
    assert f" {key}: found " in line


def test_mistakes_in_a_file_that_the_bench_file_names_are_located_in_that_file(changed: Change) -> None:
    path = changed(
        ("due: 2027-03-02", "due: soon"),
        ("expanded_uncertainty: 1 %", "expanded_uncertainty: 1 m"),
        file="standards/vibrometer.yaml",
    )
    lines = said(path)
    assert lines[0].startswith("vibrometer.yaml:8:6 due: found 'soon', wanted a date such as")
    assert "vibrometer.yaml:10:" in lines[1]
    assert "expanded_uncertainty" in lines[1]


@pytest.mark.parametrize(
    ("old", "new"), [("../sensors/simulated_cube.yaml", "none.yaml"), ("../standards/gravity.yaml", "none.yaml")]
)
def test_a_named_file_that_is_not_there_is_a_mistake(changed: Change, old: str, new: str) -> None:
    (line,) = said(changed((old, new)))
    assert "none.yaml:1:1 : found no such file" in line


def test_data_sheet_sensitivities_are_si() -> None:
    sensor = describe(SHIPPED).unit
    assert sensor.channel("unit_a_x").nominal == pytest.approx(0.660 / 9.80665)
    assert {one.name for one in sensor.channels if one.is_rate} == {
        f"{kind}_{axis}" for kind in ("gyro", "backup") for axis in ("pitch", "roll", "yaw")
    }


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("unit_a_y: {part: LIS2L02 class, unit: unit_a", "unit_a_y: {part: LIS2L02 class, unit: unit_b",
         "found unit_a_y and unit_b_y along y in unit_b, wanted one of them"),
        ("gyro_roll: {part: CRS03-11 class, unit: gyro", "gyro_roll: {part: CRS03-11 class, unit: unit_a",
         "found accelerometers and gyros in unit_a, wanted a unit of one quantity"),
        ("  unit_b: {title", "  unit_d: {title", "found unit_d, wanted a unit that a channel names"),
        ("primary: unit_a", "primary: gyro", "found gyro, wanted a unit of accelerometers that a channel names"),
        ("58 µg/√Hz", "58 µg", "found '58 µg', wanted a density of accelerometer noise such as '60 µg/√Hz'"),
        ("[1 Hz, 10 Hz]", "[10 Hz, 1 Hz]", "found 10 Hz to 1 Hz, wanted the lower one first"),
    ],
)  # fmt: skip
def test_a_sensor_file_that_contradicts_itself_is_refused_in_words(
    changed: Change, old: str, new: str, text: str
) -> None:
    (line,) = said(changed((old, new), file="sensors/simulated_cube.yaml"))
    assert line.startswith("simulated_cube.yaml:")
    assert line.endswith(text)


@pytest.mark.parametrize("path", sorted(shipped("standards").glob("*.yaml")), ids=lambda path: path.stem)
def test_a_shipped_certificate_states_values_with_expanded_uncertainty(path: Path) -> None:
    standard = load(path, Standard)
    assert standard.calibrated < standard.due
    assert standard.values
    assert all(value.coverage_factor > 0 for value in standard.values.values())


def at(day: str) -> float:
    return dt.datetime.fromisoformat(f"{day}T12:00:00+00:00").timestamp()


def test_a_standard_is_good_on_its_due_date_and_overdue_the_day_after() -> None:
    description = describe(SHIPPED)
    assert description.overdue(at("2027-03-02")) == []
    assert [late.standard for late in description.overdue(at("2027-03-03"))] == ["vibrometer"]


def test_an_overdue_standard_is_refused_with_its_certificate_and_what_would_help() -> None:
    description = describe(SHIPPED)
    with pytest.raises(StandardOverdue, match=r"vibrometer .*EX-LDV-2026-014.*found due 2027-03-02.*--allow-overdue"):
        description.refuse_overdue(at("2027-06-01"), override=False)
    assert description.refuse_overdue(at("2027-06-01"), override=True) == ["vibrometer", "time_base", "converter"]
    assert description.refuse_overdue(at("2026-06-01"), override=True) == []


def test_addresses_are_filled_in_however_deep_and_other_text_is_left_alone() -> None:
    addresses = {"gpib": 1234, "ldv_tcp": 77}
    settings = {"address": "GPIB0::19", "gateway": "x::${gpib}::y", "deep": {"a": "${ldv_tcp}/${gpib}"}, "n": 3}
    assert filled(settings, addresses) == {
        "address": "GPIB0::19",
        "gateway": "x::1234::y",
        "deep": {"a": "77/1234"},
        "n": 3,
    }
    assert filled("${unknown}", addresses) == "${unknown}"


def test_a_sensor_of_which_no_channel_is_wired_is_refused_before_anything_moves(changed: Change) -> None:
    pairs = [(f"  {name}", f"  my_{name}") for name in describe(SHIPPED).sensor.channels]
    problems = said(changed(*pairs, file="sensors/simulated_cube.yaml"))
    assert len(problems) == 1
    assert "cables: found none of the channels of ../sensors/simulated_cube.yaml (my_unit_a_x, " in problems[0]


def test_a_sensor_with_one_channel_on_the_cables_is_a_sensor(changed: Change) -> None:
    names = list(describe(SHIPPED).sensor.channels)
    pairs = [(f"  {name}", f"  my_{name}") for name in names[1:]]
    assert "unit_a_x" in describe(changed(*pairs, file="sensors/simulated_cube.yaml")).sensor.channels
