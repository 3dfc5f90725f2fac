"""What the name of a column says: "moving_gyro_z_dps" is a rate about z in °/s. Numbers are not looked at."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, replace
from typing import Literal

Role = Literal["device", "reference", "drive", "condition"]
# words of a name that say a quantity, in the order they are tried; several quantities use the same short words
WORDS: tuple[tuple[str, str], ...] = (
    ("frequency", r"freqs?|frequency|frequencies|f_?hz"),
    ("quaternion", r"quat|quaternion|quats|q|orientation"),
    ("rate", r"gyro|gyr|gyroscope|omega|w|rate|angvel|ang_?vel|angular_?(velocity|rate)|turn_rate"),
    ("acceleration", r"acc|accel|accelerometer|acceleration|specific_force|a"),
    ("excitation", r"examp|exc_?amp|excitation_?amplitude"),
    ("phase", r"phase|phi|arg"),
    ("magnitude", r"mag|magnitude|gain|abs|ratio|sensitivity"),
    ("real", r"re|real"),
    ("imaginary", r"im|imag|imaginary"),
    ("angle", r"enc|encoder|angle|theta|azimuth"),
    ("position", r"pos|position|p|translation"),
    ("temperature", r"temp|temperature"),
    ("voltage", r"volt|voltage|volts|excitation|drive|command"),
)
# endings with the unit they say; longest first
UNITS: tuple[tuple[str, str], ...] = (
    ("rad_s^_1", "rad/s"), ("deg_s^_1", "°/s"), ("m_s^_2", "m/s²"),
    ("rad_s_1", "rad/s"), ("deg_per_s", "°/s"), ("rad_per_s", "rad/s"), ("rad_s", "rad/s"), ("rads", "rad/s"),
    ("deg_s", "°/s"), ("degs", "°/s"), ("dps", "°/s"), ("rpm", "rpm"), ("m_s_2", "m/s²"), ("m_s2", "m/s²"),
    ("m_s^2", "m/s²"), ("mss", "m/s²"), ("ms2", "m/s²"), ("m/s^2", "m/s²"), ("m/s2", "m/s²"), ("m/s²", "m/s²"),
    ("rad/s", "rad/s"), ("deg/s", "°/s"), ("°/s", "°/s"), ("mg", "mg"), ("g", "g"), ("deg", "°"), ("degrees", "°"),
    ("°", "°"), ("rad", "rad"), ("mm", "mm"), ("cm", "cm"), ("m", "m"), ("khz", "kHz"), ("hz", "Hz"), ("mv", "mV"),
    ("v", "V"), ("volts", "V"), ("volt", "V"), ("degc", "°C"), ("c", "°C"), ("k", "K"), ("raw", "counts"),
    ("counts", "counts"), ("lsb", "counts"),
    ("ns", "ns"), ("us", "µs"), ("ms", "ms"), ("sec", "s"), ("seconds", "s"), ("second", "s"), ("s", "s"),
)  # fmt: skip
FITS = {
    "rate": ("rad/s", "°/s", "rpm", "counts"), "acceleration": ("m/s²", "g", "mg", "counts"), "angle": ("°", "rad"),
    "phase": ("°", "rad"), "position": ("m", "mm", "cm"), "frequency": ("Hz", "kHz"), "voltage": ("V", "mV"),
    "temperature": ("°C", "K"), "excitation": ("m/s²", "g"), "time": ("s", "ms", "µs", "ns"),
}  # fmt: skip
PER_SECOND = {"rad": "rad/s", "°": "°/s"}  # the unit of a rate whose name leaves out the second
TIME = re.compile(r"t|time|times|timestamps?|stamp|seconds|sec")
COUNTER = re.compile(r"n|n_?samples?|samples?|index|idx|row|counter|seq|sequence|frame|part|label|movement|flag")
# words of a name for what stands beside a quantity: how long it was summed, how it scatters, how it is doing
BESIDE = re.compile(r"d_?t|integral|cov\d*|covariance\d*|variance|bias|offset|status|clipping|errors?|valid|id|device")
SECONDS, SUBSECONDS = re.compile(r"secs?"), re.compile(r"([num])(?:ano|icro|illi)?_?(?:secs?|seconds?)")
UNCERTAIN = re.compile(r"(.+?)_?(?:uncertainty|uncer|unc|sigma|std|stdev)")
REFERENCE = re.compile(r"ref|reference|base|table|laser|truth|opt|mocap|vicon|optitrack|standard")


@dataclass(frozen=True)
class Named:
    """A column by its name; `unit` is "" where the name says none, `why` is what the guess rests on."""

    column: str
    quantity: str
    unit: str = ""
    axis: str = ""
    component: str = ""
    role: Role = "device"
    uncertainty_of: str = ""
    uncertainty_column: str = ""
    why: str = ""


def named(column: str, stated: str = "") -> Named | None:
    """What a column is, by its name and the unit `stated` beside it; None if they say nothing.

    Three quantities are no manifest's: "time", "part of time" and "left out".
    """
    plain = _plain(f"{column} {stated}")
    unit = _unit(plain if stated else _plain(re.sub(r"\[\d+(,:)?\]$", "", column)))
    tokens = [token for token in re.split(r"[_/.]+", plain) if token]
    if not tokens or COUNTER.fullmatch(_plain(column)) or COUNTER.fullmatch(tokens[0]):
        return Named(column, "left out", why="a counter or a mark")
    if any(BESIDE.fullmatch(token) for token in tokens):
        return Named(column, "left out", why="something beside a quantity, by its name")
    if (part := _part(column, tokens)) is not None:
        return part
    uncertain = UNCERTAIN.fullmatch(plain)
    if uncertain is not None:
        return Named(column, "magnitude", uncertainty_of=uncertain[1], why="an uncertainty")
    word = next((token for token in (*tokens[:2], tokens[-1]) if TIME.fullmatch(token)), None)
    if word is not None and not {"x", "y", "z"} & set(tokens):
        said = unit if unit in FITS["time"] else ""
        return Named(column, "time", said, why=f"'{word}' is time{f', its ending says {said}' if said else ''}")
    found = _quantity(column, tokens, unit)
    return found if found is not None or not stated else _by_unit(column, tokens, unit)


def _part(column: str, tokens: list[str]) -> Named | None:
    """Whole seconds of a stamp, or what lies below them."""
    if "stamp" not in tokens[:-1]:
        return None
    if SECONDS.fullmatch(tokens[-1]):
        return Named(column, "part of time", "s")
    below = SUBSECONDS.fullmatch(tokens[-1])
    return None if below is None else Named(column, "part of time", {"n": "ns", "u": "µs", "m": "ms"}[below[1]])


def _by_unit(column: str, tokens: list[str], unit: str) -> Named | None:
    """What a unit beside a name says alone."""
    axis = next((token for token in tokens if token in ("x", "y", "z")), "")
    for quantity in ("time", "acceleration", "rate", "voltage", "temperature", "frequency"):
        if unit in FITS[quantity] and unit != "counts":
            why = f"its unit {unit} is one of {quantity}"
            return Named(column, quantity, unit, "" if quantity == "time" else axis, role=_role(quantity, []), why=why)
    return None


def _plain(column: str) -> str:
    """Lower case with underscores: `AccX [m/s^2]` becomes `acc_x_m/s^2`."""
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", column)
    text = re.sub(r"[\s\[\]():,;#%-]+", "_", text).strip("_").lower()
    # gyrox, accz, qw: the axis is stuck to the word
    return re.sub(r"(?<![a-z])(gyro|gyr|acc|accel|omega|pos|quat|mag|q|w|a|p)([wxyz])(?![a-z])", r"\1_\2", text)


def _unit(plain: str) -> str:
    for ending, unit in UNITS:
        if plain.endswith(("_" + ending, "." + ending)):
            return unit
    return ""


def _quantity(column: str, tokens: list[str], unit: str) -> Named | None:
    axis = next((token for token in tokens if token in ("x", "y", "z")), "")
    part = next((token for token in tokens if token in ("w", "x", "y", "z")), "")
    pairs = [f"{one}_{other}" for one, other in itertools.pairwise(tokens)]
    for quantity, words in WORDS:
        word = next((token for token in (*pairs, *tokens) if re.fullmatch(words, token)), None)
        if word is None or (quantity == "rate" and word == "w" and not axis):
            continue
        if quantity == "magnitude" and axis:
            return Named(column, "left out", why="a magnetometer, which is not calibrated here")
        unit = PER_SECOND.get(unit, unit) if quantity == "rate" else unit
        fitting = unit if unit in FITS.get(quantity, ()) else ""
        why = f"'{word}' is {quantity}{f', its ending says {fitting}' if fitting else ''}"
        if quantity == "quaternion":
            number = re.search(r"\[(?::,)?([0-3])(?:,:)?\]$", column)
            if number is not None and not part:
                part, why = (
                    "wxyz"[int(number[1])],
                    f"{why}; number {number[1]} taken as {'wxyz'[int(number[1])]}, check",
                )
            return Named(column, quantity, component=part, role="reference", why=why)
        return _numbered(Named(column, quantity, fitting, axis, role=_role(quantity, tokens), why=why))
    return None


def _numbered(one: Named) -> Named:
    """Column 0, 1 or 2 of a table is x, y or z where nothing else says."""
    number = re.search(r"\[(?::,)?([0-2])(?:,:)?\]$", one.column)
    if number is None or one.axis or one.quantity not in ("rate", "acceleration", "position"):
        return one
    axis = "xyz"[int(number[1])]
    return replace(one, axis=axis, why=f"{one.why}; number {number[1]} taken as {axis}, check")


def _role(quantity: str, tokens: list[str]) -> Role:
    if quantity in ("frequency", "excitation", "angle", "position"):
        return "reference"
    if quantity == "voltage":
        return "drive"
    if quantity == "temperature":
        return "condition"
    return "reference" if any(REFERENCE.fullmatch(token) for token in tokens) else "device"
