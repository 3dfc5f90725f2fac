"""Quantities with units at the door, SI floats inside.

    parse("500 Hz", "frequency")            500.0 (Hz)
    parse("33 1/3 rpm", "rate")             3.4907 (rad/s)
    parse("650 mV/g", "sensitivity")        0.066281 (V/(m/s²))
    format_quantity(0.0005, "time")         '500 µs'

Every kind has its own short list of units, and nothing crosses from one kind to another: volts peak, volts rms and dBm
are different kinds, because only the waveform and the load could convert them. "g" is standard gravity, 9.80665 m/s².

In settings models use the types at the end of this file (`Frequency`, `Length`, …): they take text with a unit and
nothing else, hold an SI float, and are written to JSON as text in the SI unit, which reads back to the same float.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

from rig.errors import BadInput

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic.json_schema import JsonSchemaValue
    from pydantic_core import CoreSchema

STANDARD_GRAVITY = 9.80665  # m/s², exact: 3rd CGPM, 1901
DEGREE = (math.pi, 180.0)  # rad, as numerator and denominator


class UnitError(BadInput, ValueError):
    """A text that is not a quantity of the kind wanted; the message is `found …, wanted …`."""


@dataclass(frozen=True)
class Unit:
    """A unit of one kind: SI = number · multiply / divide + zero, or multiply · 10^(number/10) for a decibel unit.

    Two factors instead of one keep round numbers round: 20 µm is 20 / 1e6, exactly the float 2e-05.
    """

    symbol: str
    multiply: float = 1.0
    divide: float = 1.0
    zero: float = 0.0
    decibel: bool = False

    def to_si(self, number: float) -> float:
        """SI value of `number` of this unit; infinite where a float cannot hold it."""
        if self.decibel:
            return self.multiply * 10.0 ** (number / 10.0) if number < 3000.0 else math.inf
        return number * self.multiply / self.divide + self.zero

    def from_si(self, value: float) -> float:
        """How many of this unit make the SI `value`."""
        if self.decibel:
            return 10.0 * math.log10(value / self.multiply) if value > 0.0 else -math.inf
        return (value - self.zero) * self.divide / self.multiply


@dataclass(frozen=True)
class Kind:
    """A kind of quantity: its name in a sentence, an example, its units, and the rungs it is shown in.

    `units` maps every spelling to its unit. `si` is the unit with factor one. `ladder` lists the units used for
    display, largest first, each with the smallest magnitude (in that unit) it is used for.
    """

    name: str
    noun: str
    example: str
    units: Mapping[str, Unit]
    si: Unit
    ladder: tuple[tuple[Unit, float], ...]

    @property
    def wanted(self) -> str:
        """`a frequency such as '500 Hz'`."""
        return f"{self.noun} such as '{self.example}'"

    @cached_property
    def pattern(self) -> str:
        """The texts that are read, as a regular expression that Python and JSON Schema understand alike."""
        spelled = "|".join(re.escape(s).replace("/", r"\/") for s in sorted(self.units, key=len, reverse=True))
        return f"^{_SPACE}({_NUMBER}){_SPACE}({spelled}){_SPACE}$"


_SPACE = "[ \u00a0\u202f]*"
_SIGN = r"[-+\u2212]?"
_DECIMAL = r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_FRACTION = r"(?:[0-9]{1,9} )?[0-9]{1,9}\/[1-9][0-9]{0,8}|[0-9]{1,9} ?[⅓⅔½¼¾]"
_NUMBER = f"{_SIGN}(?:{_FRACTION}|{_DECIMAL})"
_VULGAR = MappingProxyType({"⅓": " 1/3", "⅔": " 2/3", "½": " 1/2", "¼": " 1/4", "¾": " 3/4"})

# One way to write a symbol here, several ways to write it in a file: µ is also μ (the Greek letter) or u.
_SPELLINGS = MappingProxyType(
    {
        "µ": ("µ", "μ", "u"),
        "²": ("²", "^2"),
        "°C": ("°C", "degC"),
        "°": ("°", "deg"),
        "pk": ("pk", " pk"),
        "rms": ("rms", " rms"),
        "√": ("√", "rt"),
    }
)
_SPELLED = re.compile("(" + "|".join(sorted(_SPELLINGS, key=len, reverse=True)) + ")")
_PREFIXES = MappingProxyType(
    {
        "n": (1.0, 1e9),
        "µ": (1.0, 1e6),
        "m": (1.0, 1e3),
        "c": (1.0, 1e2),
        "": (1.0, 1.0),
        "k": (1e3, 1.0),
        "M": (1e6, 1.0),
        "G": (1e9, 1.0),
    }
)


def _spellings(symbol: str) -> Iterator[str]:
    parts = [_SPELLINGS.get(part, (part,)) for part in _SPELLED.split(symbol)]
    return ("".join(choice) for choice in product(*parts))


def _scaled(symbol: str, prefixes: Iterable[str], multiply: float = 1.0, divide: float = 1.0) -> list[Unit]:
    """One unit with SI prefixes, e.g. ("Hz", ["", "k"]) gives Hz and kHz."""
    scales = {prefix: _PREFIXES[prefix] for prefix in prefixes}
    return [Unit(p + symbol, up * multiply, down * divide) for p, (up, down) in scales.items()]


def _kind(name: str, noun: str, example: str, units: Iterable[Unit], si: str, ladder: Mapping[str, float]) -> Kind:
    """A kind from its units; `ladder` names the display units, largest first, with the smallest magnitude for each."""
    by_symbol = {unit.symbol: unit for unit in units}
    spelled = {spelling: unit for unit in by_symbol.values() for spelling in _spellings(unit.symbol)}
    rungs = tuple((by_symbol[symbol], least) for symbol, least in ladder.items())
    return Kind(name, noun, example, MappingProxyType(spelled), by_symbol[si], rungs)


def _per(numerator: str, denominators: Mapping[str, tuple[float, float]], prefixes: Iterable[str]) -> list[Unit]:
    """Units such as mV/g: each denominator is given as the (multiply, divide) of one of it in SI."""
    return [
        unit
        for denominator, (up, down) in denominators.items()
        for unit in _scaled(f"{numerator}/{denominator}", prefixes, multiply=down, divide=up)
    ]


_MOST = ("n", "µ", "m", "")
_ACCELERATIONS = {"g": (STANDARD_GRAVITY, 1.0), "(m/s²)": (1.0, 1.0)}
_RATES = {"(°/s)": DEGREE, "°/s": DEGREE, "(rad/s)": (1.0, 1.0)}
_PER_SECOND = [Unit("rad/s"), Unit("mrad/s", 1.0, 1e3), Unit("°/s", *DEGREE), Unit("dps", *DEGREE)]
_TURNS = [Unit("rpm", 2.0 * math.pi, 60.0), Unit("rev/min", 2.0 * math.pi, 60.0), Unit("rev/s", 2.0 * math.pi)]
_DRIFTS = [Unit("°/h", math.pi, 648000.0)]
_SMALL_ANGLES = [Unit("arcmin", math.pi, 10800.0), Unit("arcsec", math.pi, 648000.0), Unit("rev", 2.0 * math.pi)]
_IN_BRACKETS = [Unit("(m/s)/V"), Unit("(mm/s)/V", 1.0, 1e3), Unit("(µm/s)/V", 1.0, 1e6)]

# name, noun, example; every unit; the SI unit; the ladder of display units
_ALL_KINDS = (
    _kind("frequency", "a frequency", "500 Hz",
          _scaled("Hz", ("m", "", "k", "M", "G")), "Hz", {"GHz": 1, "MHz": 1, "kHz": 1, "Hz": 0.1, "mHz": 0}),
    _kind("time", "a time", "300 ms",
          [*_scaled("s", _MOST), Unit("min", 60.0), Unit("h", 3600.0)], "s", {"s": 1, "ms": 1, "µs": 1, "ns": 0}),
    _kind("length", "a length", "80 µm",
          _scaled("m", (*_MOST, "c")), "m", {"m": 1, "mm": 1, "µm": 1, "nm": 0}),
    _kind("velocity", "a velocity", "50 mm/s",
          _scaled("m/s", (*_MOST, "c")), "m/s", {"m/s": 1, "mm/s": 1, "µm/s": 1, "nm/s": 0}),
    _kind("acceleration", "an acceleration", "0.5 g",
          [*_scaled("g", ("µ", "m", ""), STANDARD_GRAVITY), *_scaled("m/s²", ("µ", "m", "c", ""))], "m/s²",
          {"g": 0.1, "mg": 1, "µg": 0}),
    _kind("angle", "an angle", "90 °",
          [*_scaled("rad", ("µ", "m", "")), Unit("°", *DEGREE), *_SMALL_ANGLES], "rad", {"°": 0.1, "arcsec": 0}),
    _kind("rate", "an angular rate", "45 rpm",
          [*_PER_SECOND, *_TURNS, *_DRIFTS], "rad/s", {"°/s": 0.01, "°/h": 0}),
    _kind("voltage", "a voltage", "2.5 V",
          _scaled("V", _MOST), "V", {"V": 1, "mV": 1, "µV": 1, "nV": 0}),
    _kind("peak_voltage", "a peak voltage", "1 Vpk",
          _scaled("Vpk", _MOST), "Vpk", {"Vpk": 1, "mVpk": 1, "µVpk": 1, "nVpk": 0}),
    _kind("rms_voltage", "an rms voltage", "1 Vrms",
          _scaled("Vrms", _MOST), "Vrms", {"Vrms": 1, "mVrms": 1, "µVrms": 1, "nVrms": 0}),
    _kind("power", "a power", "-10 dBm",
          [Unit("dBm", 1e-3, decibel=True), *_scaled("W", _MOST)], "W", {"dBm": -math.inf}),
    _kind("temperature", "a temperature", "23 °C",
          [Unit("K"), Unit("°C", zero=273.15)], "K", {"°C": -math.inf}),
    _kind("sensitivity", "an accelerometer sensitivity", "650 mV/g",
          _per("V", _ACCELERATIONS, ("µ", "m", "")), "V/(m/s²)", {"V/g": 1, "mV/g": 0.1, "µV/g": 0}),
    _kind("rate_sensitivity", "a gyro sensitivity", "3.5 mV/(°/s)",
          _per("V", _RATES, ("µ", "m", "")), "V/(rad/s)", {"V/(°/s)": 1, "mV/(°/s)": 0.1, "µV/(°/s)": 0}),
    _kind("acceleration_density", "a density of accelerometer noise", "60 µg/√Hz",
          [*_scaled("g/√Hz", ("µ", "m", ""), STANDARD_GRAVITY), *_scaled("(m/s²)/√Hz", ("µ", "m", ""))],
          "(m/s²)/√Hz", {"g/√Hz": 0.1, "mg/√Hz": 1, "µg/√Hz": 0}),
    _kind("rate_density", "a density of gyro noise", "0.05 (°/s)/√Hz",
          [*_scaled("(°/s)/√Hz", ("m", ""), *DEGREE), *_scaled("°/s/√Hz", ("m", ""), *DEGREE),
           *_scaled("(rad/s)/√Hz", ("µ", "m", ""))], "(rad/s)/√Hz", {"(°/s)/√Hz": 0.01, "m(°/s)/√Hz": 0}),
    _kind("vibrometer_scale", "a vibrometer scale", "25 mm/s/V",
          [*_scaled("m/s/V", ("µ", "m", "")), *_IN_BRACKETS], "m/s/V", {"m/s/V": 1, "mm/s/V": 0.1, "µm/s/V": 0}),
    _kind("ratio", "a ratio", "1 %",
          [Unit(""), Unit("%", 1.0, 1e2), Unit("ppm", 1.0, 1e6), Unit("ppb", 1.0, 1e9)], "",
          {"": 1, "%": 0.1, "ppm": 0}),
)  # fmt: skip
KINDS: Mapping[str, Kind] = MappingProxyType({kind.name: kind for kind in _ALL_KINDS})


def parse(text: object, kind: str) -> float:
    """The SI value of a text such as '500 Hz'; KeyError if there is no such kind.

    Raises UnitError: a bare number, a unit of another kind, a number that a float cannot hold.
    """
    known = KINDS[kind]
    found = re.fullmatch(known.pattern, text) if isinstance(text, str) else None
    value = known.units[found[2]].to_si(_number(found[1])) if found else math.nan
    if not math.isfinite(value):
        raise UnitError(f"found '{text}', wanted {known.wanted}")
    return value


def format_quantity(value: float, kind: str, digits: int = 4, unit: str | None = None) -> str:
    """The SI `value` with `digits` significant digits, in a unit that suits its size or in the `unit` named."""
    known = KINDS[kind]
    shown = known.units[unit] if unit is not None else _suitable(value, known)
    return f"{shown.from_si(value):.{digits}g} {shown.symbol}".rstrip()


def si_text(value: float, kind: str) -> str:
    """The SI `value` as text that `parse` turns back into exactly the same float: '20.0 Hz'."""
    return f"{float(value)!r} {KINDS[kind].si.symbol}".rstrip()


def _suitable(value: float, kind: Kind) -> Unit:
    if value == 0.0 and kind.ladder[0][1] >= 0.0:
        return kind.si
    fitting = (unit for unit, least in kind.ladder if abs(unit.from_si(value)) * (1.0 + 1e-12) >= least)
    unit = next(fitting, kind.si)
    return kind.si if unit.decibel and value <= 0.0 else unit


def _number(text: str) -> float:
    """A decimal, or a fraction such as '33 1/3', '33⅓' or '100/3'."""
    negative, text = text[0] in "-\u2212", text.lstrip("+-\u2212")
    for sign, spelled in _VULGAR.items():
        text = text.replace(f" {sign}", spelled).replace(sign, spelled)
    size = float(sum(Fraction(part) for part in text.split())) if "/" in text else float(text)
    return -size if negative else size


@dataclass(frozen=True)
class Quantity:
    """Marks a float of a settings model as a quantity: read with its unit, held in SI, written with its unit."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema

        def read(text: Any) -> float:
            return parse(text, self.kind)

        def write(value: float) -> str:
            return si_text(value, self.kind)

        writer = core_schema.plain_serializer_function_ser_schema(write, when_used="json")
        return core_schema.no_info_before_validator_function(read, handler(source), serialization=writer)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        kind = KINDS[self.kind]
        return {
            "type": "string",
            "pattern": kind.pattern,
            "examples": [kind.example],
            "description": kind.wanted,
            "x-quantity": kind.name,
        }


Frequency = Annotated[float, Quantity("frequency")]  # Hz
Time = Annotated[float, Quantity("time")]  # s
Length = Annotated[float, Quantity("length")]  # m
Velocity = Annotated[float, Quantity("velocity")]  # m/s
Acceleration = Annotated[float, Quantity("acceleration")]  # m/s²
Angle = Annotated[float, Quantity("angle")]  # rad
Rate = Annotated[float, Quantity("rate")]  # rad/s
Voltage = Annotated[float, Quantity("voltage")]  # V, direct or instantaneous
PeakVoltage = Annotated[float, Quantity("peak_voltage")]  # V, peak
RmsVoltage = Annotated[float, Quantity("rms_voltage")]  # V, rms
Power = Annotated[float, Quantity("power")]  # W; dBm at the door
Temperature = Annotated[float, Quantity("temperature")]  # K
Sensitivity = Annotated[float, Quantity("sensitivity")]  # V/(m/s²)
RateSensitivity = Annotated[float, Quantity("rate_sensitivity")]  # V/(rad/s)
VibrometerScale = Annotated[float, Quantity("vibrometer_scale")]  # (m/s)/V
Ratio = Annotated[float, Quantity("ratio")]  # 1
