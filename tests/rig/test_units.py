"""Quantities with units at the door: what is read, what is refused, and that nothing changes on the way."""

from __future__ import annotations

import contextlib
import json
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rig.errors import BadInput
from rig.units import KINDS, Acceleration, Frequency, Length, Rate, UnitError, format_quantity, parse, si_text

RPM = 2 * math.pi / 60
KIND_NAMES = sorted(KINDS)
UNITS = sorted((kind, spelling) for kind in KINDS for spelling in KINDS[kind].units)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("500 Hz", "frequency", 500.0),
        ("5kHz", "frequency", 5000.0),
        ("300 ms", "time", 0.3),
        ("10 µs", "time", 1e-5),
        ("10 us", "time", 1e-5),
        ("80 μm", "length", 8e-5),
        ("1e-3 m", "length", 1e-3),
        ("25 mm/s", "velocity", 0.025),
        ("0.5 g", "acceleration", 4.903325),
        ("-0.5 mg", "acceleration", -0.5e-3 * 9.80665),
        ("\u22121 g", "acceleration", -9.80665),
        ("9.8123 m/s²", "acceleration", 9.8123),
        ("9.8123 m/s^2", "acceleration", 9.8123),
        ("90 °", "angle", math.pi / 2),
        ("20 arcsec", "angle", math.radians(20 / 3600)),
        ("45 rpm", "rate", 45 * RPM),
        ("33 1/3 rpm", "rate", 100 / 3 * RPM),
        ("33⅓ rpm", "rate", 100 / 3 * RPM),
        ("33 ⅓ rpm", "rate", 100 / 3 * RPM),
        ("-33 1/3 rpm", "rate", -100 / 3 * RPM),
        ("100/3 rpm", "rate", 100 / 3 * RPM),
        ("200 °/s", "rate", 100 / 3 * RPM),
        ("270 deg/s", "rate", 45 * RPM),
        ("2.5 V", "voltage", 2.5),
        ("100 mVpk", "peak_voltage", 0.1),
        ("1 V pk", "peak_voltage", 1.0),
        ("1 V rms", "rms_voltage", 1.0),
        ("0 dBm", "power", 1e-3),
        ("-10 dBm", "power", 1e-4),
        ("23 °C", "temperature", 296.15),
        ("296.15 K", "temperature", 296.15),
        ("650 mV/g", "sensitivity", 0.65 / 9.80665),
        ("66.3 mV/(m/s²)", "sensitivity", 0.0663),
        ("3.61 mV/(°/s)", "rate_sensitivity", 3.61e-3 * 180 / math.pi),
        ("3.61 mV/deg/s", "rate_sensitivity", 3.61e-3 * 180 / math.pi),
        ("25 mm/s/V", "vibrometer_scale", 0.025),
        ("1 %", "ratio", 0.01),
        ("20 ppm", "ratio", 2e-5),
        ("1", "ratio", 1.0),
        ("\u00a0500\u202fHz ", "frequency", 500.0),
    ],
)
def test_a_text_with_its_unit_becomes_si(text: str, kind: str, value: float) -> None:
    assert parse(text, kind) == pytest.approx(value, rel=1e-15)


def test_round_numbers_stay_round() -> None:
    assert parse("20 µm", "length") == 2e-05
    assert parse("4 µs", "time") == 4e-06
    assert parse("0.1 Hz", "frequency") == 0.1


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("500", "frequency", "found '500', wanted a frequency such as '500 Hz'"),
        (500, "frequency", "found '500', wanted a frequency such as '500 Hz'"),
        (True, "time", "found 'True', wanted a time such as '300 ms'"),
        (None, "length", "found 'None', wanted a length such as '80 µm'"),
        ("5 V", "peak_voltage", "found '5 V', wanted a peak voltage such as '1 Vpk'"),
        ("5 Vrms", "peak_voltage", "found '5 Vrms', wanted a peak voltage such as '1 Vpk'"),
        ("5 Vpk", "rms_voltage", "found '5 Vpk', wanted an rms voltage such as '1 Vrms'"),
        ("5 Vpk", "voltage", "found '5 Vpk', wanted a voltage such as '2.5 V'"),
        ("0 dBm", "peak_voltage", "found '0 dBm', wanted a peak voltage such as '1 Vpk'"),
        ("0,5 g", "acceleration", "found '0,5 g', wanted an acceleration such as '0.5 g'"),
        ("0.5 G", "acceleration", "found '0.5 G', wanted an acceleration such as '0.5 g'"),
        ("500 hz", "frequency", "found '500 hz', wanted a frequency such as '500 Hz'"),
        ("1e999 Hz", "frequency", "found '1e999 Hz', wanted a frequency such as '500 Hz'"),
        ("nan Hz", "frequency", "found 'nan Hz', wanted a frequency such as '500 Hz'"),
        ("9999 dBm", "power", "found '9999 dBm', wanted a power such as '-10 dBm'"),
        ("1/0 rpm", "rate", "found '1/0 rpm', wanted an angular rate such as '45 rpm'"),
        ("٥ Hz", "frequency", "found '٥ Hz', wanted a frequency such as '500 Hz'"),
        ("5 Hz\n", "frequency", "found '5 Hz\n', wanted a frequency such as '500 Hz'"),
    ],
)
def test_anything_else_is_refused_with_what_was_found_and_wanted(text: object, kind: str, message: str) -> None:
    with pytest.raises(UnitError) as caught:
        parse(text, kind)
    assert str(caught.value) == message
    assert isinstance(caught.value, BadInput)


@given(text=st.text(max_size=30), kind=st.sampled_from(KIND_NAMES))
def test_no_text_raises_anything_but_a_unit_error(text: str, kind: str) -> None:
    with contextlib.suppress(UnitError):
        assert math.isfinite(parse(text, kind))


@given(number=st.floats(allow_nan=False, allow_infinity=False), unit=st.sampled_from(UNITS))
def test_every_spelling_of_every_unit_is_read_or_does_not_fit_a_float(number: float, unit: tuple[str, str]) -> None:
    kind, spelling = unit
    try:
        value = parse(f"{number!r} {spelling}", kind)
    except UnitError:
        assert not math.isfinite(KINDS[kind].units[spelling].to_si(number))
    else:
        assert value == KINDS[kind].units[spelling].to_si(number)


@given(value=st.floats(allow_nan=False, allow_infinity=False), kind=st.sampled_from(KIND_NAMES))
def test_text_in_the_si_unit_reads_back_to_the_same_float(value: float, kind: str) -> None:
    assert parse(si_text(value, kind), kind) == value


@given(value=st.floats(1e-9, 1e6), negative=st.booleans(), kind=st.sampled_from(KIND_NAMES))
def test_what_is_shown_reads_back_within_its_digits(value: float, negative: bool, kind: str) -> None:
    value = -value if negative and kind not in ("power", "temperature") else value
    shown = parse(format_quantity(value, kind, digits=12), kind)
    assert shown == pytest.approx(value, rel=1e-10, abs=1e-9 if kind == "temperature" else 0)


@pytest.mark.parametrize(
    ("value", "kind", "shown"),
    [
        (500.0, "frequency", "500 Hz"),
        (5000.0, "frequency", "5 kHz"),
        (0.0, "frequency", "0 Hz"),
        (5e-4, "time", "500 µs"),
        (600.0, "time", "600 s"),
        (1e-4, "length", "100 µm"),
        (0.14, "length", "140 mm"),
        (4.903325, "acceleration", "0.5 g"),
        (0.0, "acceleration", "0 m/s²"),
        (-1.2748645, "acceleration", "-0.13 g"),
        (45 * RPM, "rate", "270 °/s"),
        (0.065 / 9.80665, "sensitivity", "65 mV/g"),
        (0.2, "rate_sensitivity", "3.491 mV/(°/s)"),
        (1e-3, "power", "0 dBm"),
        (0.0, "power", "0 W"),
        (296.15, "temperature", "23 °C"),
        (1.0, "ratio", "1"),
        (0.01, "ratio", "1 %"),
        (2e-5, "ratio", "20 ppm"),
        (math.inf, "length", "inf m"),
    ],
)
def test_a_quantity_is_shown_in_a_unit_that_suits_its_size(value: float, kind: str, shown: str) -> None:
    assert format_quantity(value, kind) == shown


def test_a_quantity_can_be_shown_in_a_named_unit() -> None:
    assert format_quantity(45 * RPM, "rate", unit="rpm") == "45 rpm"
    assert format_quantity(4.903325, "acceleration", unit="m/s²", digits=7) == "4.903325 m/s²"


class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid")
    stop: Frequency = Field(default=500.0, gt=0)
    speed: Rate = 45 * RPM
    limits: dict[str, Acceleration] = {}
    stroke: Length | None = None


def test_a_settings_model_takes_units_and_holds_si() -> None:
    settings = Settings.model_validate({"stop": "1 kHz", "stroke": "100 µm", "limits": {"a": "0.5 g"}})
    assert (settings.stop, settings.stroke, settings.limits) == (1000.0, 1e-4, {"a": 4.903325})


@pytest.mark.parametrize("bare", [500, 500.0, "500", True, None, [500]])
def test_a_settings_model_refuses_a_bare_number(bare: object) -> None:
    with pytest.raises(ValidationError, match="wanted a frequency such as '500 Hz'"):
        Settings.model_validate({"stop": bare})


@given(st.floats(1e-6, 1e6), st.floats(-1e3, 1e3))
def test_recorded_settings_read_back_to_the_same_settings(stop: float, speed: float) -> None:
    settings = Settings.model_validate({"stop": si_text(stop, "frequency"), "speed": si_text(speed, "rate")})
    assert Settings.model_validate_json(settings.model_dump_json()) == settings
    assert json.loads(settings.model_dump_json())["stop"] == f"{stop!r} Hz"


def test_the_schema_shows_editors_the_pattern_and_an_example() -> None:
    stop = Settings.model_json_schema()["properties"]["stop"]
    assert stop["type"] == "string"
    assert stop["examples"] == ["500 Hz"]
    assert re.search(stop["pattern"], "500 Hz")
    assert not re.search(stop["pattern"], "500")


@pytest.mark.parametrize("kind", KIND_NAMES)
def test_every_kind_reads_its_own_example_and_no_other_kind_reads_a_unit_that_is_not_its_own(kind: str) -> None:
    assert math.isfinite(parse(KINDS[kind].example, kind))
    own = {unit.symbol for unit in KINDS[kind].units.values()}
    for other in set(KINDS) - {kind}:
        symbol = KINDS[other].si.symbol
        if symbol not in own:
            with pytest.raises(UnitError):
                parse(f"1 {symbol}", kind)
