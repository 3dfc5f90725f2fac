"""Turns volts of a unit into m/s² and rad/s by its repaired model; the tail of every module made with `--model`.

`rig export --to python --model FILE` copies this file, with the numbers of one model in place of the empty ones below.
It needs the standard library only (Python 3.10 or later).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

# numbers: begin
PROVENANCE: Mapping[str, Any] = {}
CHANNELS: Mapping[str, Mapping[str, Any]] = {}
APART: Sequence[Sequence[tuple[int, float]]] = ()
FELT: Sequence[tuple[int, int, int | None, float]] = ()
WRITTEN: Sequence[tuple[int, Any, Mapping[str, int]]] = ()
PASSES: int = 0
RATE: float | None = None
NOT_UNDONE: Sequence[str] = ()
# numbers: end

EPSILON = 2.0**-52
UNSETTLED = 1e-3
MOST = 80  # steps of an iteration: halving alone would do in these


def counts_to_volts(counts: Any, low: float = -10.0, high: float = 10.0) -> Any:
    """Volts of raw 16-bit offset-binary counts, a number or a sequence of them: 0 is `low`, 65535 is `high`."""
    if isinstance(counts, Sequence):
        return [counts_to_volts(count, low, high) for count in counts]
    return counts / 65535.0 * (high - low) + low


def apply(
    raw: Mapping[str, Any], *, rate: float | None = None, temperature: Any = None, supply: Any = None, time: Any = None
) -> dict[str, Any]:
    """Acceleration (m/s²) and rate (rad/s) of every channel from the volts of every channel of CHANNELS.

    Numbers, or records of one length. With `rate` (samples per second, which must be RATE) records lose the lag of
    filters and delays and what is felt of angular acceleration too; without it they keep them. `temperature` °C,
    `supply` V, `time` s since the first record began: numbers or one for each sample; nominal ones without. NOT_UNDONE
    says what stays in the numbers. Raises ValueError for other channels, lengths and rates.
    """
    single, columns = _columns(raw)
    if rate is not None and (RATE is None or single or abs(rate / RATE - 1.0) > 1e-9):
        raise ValueError(f"found the rate {rate}, wanted records of {RATE} samples per second, as they were exported")
    count = len(columns[0])
    given = {"temperature": temperature, "supply": supply, "time": time}
    conditions = {of: _spread(value, count) for of, value in given.items() if value is not None}
    numbers = list(CHANNELS.values())
    seen = [_input(mine, column, conditions) for mine, column in zip(numbers, columns, strict=True)]
    if rate is not None:
        seen = [_early(mine, column) for mine, column in zip(numbers, seen, strict=True)]
    seen = [[_straight(mine, value) for value in column] for mine, column in zip(numbers, seen, strict=True)]
    found = _apart(seen)
    before = found
    for _ in range(PASSES):
        before, found = found, _apart(_less_written(_less(seen, found, rate), found, conditions))
    if WRITTEN:
        found = [[_settled(*pair) for pair in zip(*pairs, strict=True)] for pairs in zip(found, before, strict=True)]
    return {name: column[0] if single else column for name, column in zip(CHANNELS, found, strict=True)}


def uncertainty(channel: str, value: float) -> float:
    """Standard uncertainty of a corrected value from those of sensitivity and zero output, SI."""
    mine = CHANNELS[channel]
    parts = [(mine["u_sensitivity"], value), (mine["u_zero"], 1.0)]
    known = [u * size / mine["sensitivity"] for u, size in parts if u is not None]
    return math.hypot(*known) if known else math.nan


def _columns(raw: Mapping[str, Any]) -> tuple[bool, list[list[float]]]:
    if set(raw) != set(CHANNELS):
        raise ValueError(f"found the channels {', '.join(raw)}, wanted {', '.join(CHANNELS)}")
    single = all(isinstance(raw[name], (int, float)) for name in CHANNELS)
    columns = [[float(raw[name])] if single else [float(volt) for volt in raw[name]] for name in CHANNELS]
    if len({len(column) for column in columns}) != 1:
        raise ValueError("found records of several lengths, wanted one length")
    return single, columns


def _spread(value: Any, count: int) -> list[float]:
    if isinstance(value, (int, float)):
        return [float(value)] * count
    spread = [float(one) for one in value]
    if len(spread) != count:
        raise ValueError(f"found {len(spread)} values of a condition, wanted one or {count}")
    return spread


def _input(mine: Mapping[str, Any], volts: Sequence[float], conditions: Mapping[str, Sequence[float]]) -> list[float]:
    """What drives the output: less zero, by sensitivity, both as they are under these conditions."""
    found = []
    for n, volt in enumerate(volts):
        zero, gain = mine["zero"], 1.0
        for drift in mine["drifts"]:
            phi = _phi(drift, conditions[drift["of"]][n] if drift["of"] in conditions else None)
            zero = zero * (1.0 + drift["zero"] * phi) + mine["sensitivity"] * drift["shift"] * phi
            gain = gain * (1.0 + drift["gain"] * phi)
        found.append((volt - zero) / (mine["sensitivity"] * gain))
    return found


def _phi(drift: Mapping[str, Any], value: float | None) -> float:
    if not drift["of"]:
        return 1.0
    if value is None:
        return 0.0  # as in nominal conditions
    return math.exp(-value / drift["decay"]) if drift["decay"] else value - drift["reference"]


def _early(mine: Mapping[str, Any], signal: Sequence[float]) -> list[float]:
    """The record without lag and delay: Σ taps[k]·signal[i + ahead + k − half], beyond the ends their own value."""
    taps, last = mine["taps"], len(signal) - 1
    first = mine["ahead"] - len(taps) // 2
    return [
        sum(tap * signal[min(max(i + first + k, 0), last)] for k, tap in enumerate(taps)) for i in range(len(signal))
    ]


def _straight(mine: Mapping[str, Any], value: float) -> float:
    """Without the characteristics, from the last to the first; NaN where no input makes this output."""
    for bend in reversed(mine["bends"]):
        w = value - bend["shift"]
        value = _root(w, *bend["above"]) if w >= 0.0 else -_root(-w, *bend["below"])
    return value


def _root(w: float, first: float, second: float, third: float, top: float | None, least: float) -> float:
    """x of w = first·x + second·x² + third·x³ by Newton's rule kept between bounds that close in; NaN beyond `top`."""
    if not math.isfinite(w) or top == 0.0:
        return math.nan
    if top is not None and w > top * (first + top * (second + top * third)):
        return math.nan
    low, high = 0.0, w / least if top is None else top
    x = min(w / first, high)
    for _ in range(MOST):
        off = x * (first + x * (second + x * third)) - w
        low, high = x if off <= 0.0 else low, x if off >= 0.0 else high
        slope = first + x * (2.0 * second + 3.0 * x * third)
        following = x - off / slope if slope != 0.0 else math.nan
        if not low <= following <= high:
            following = 0.5 * (low + high)
        done = abs(following - x) <= EPSILON * abs(following)
        x = following
        if done:
            break
    return x


def _apart(felt: Sequence[Sequence[float]]) -> list[list[float]]:
    """What every axis went through, of what every channel felt."""
    return [[sum(share * felt[k][n] for k, share in row) for n in range(len(felt[0]))] for row in APART]


def _less(seen: Sequence[Sequence[float]], found: Sequence[Sequence[float]], rate: float | None) -> list[list[float]]:
    """Less what is felt of turning and, in records of a known rate, of changes."""
    left = [list(column) for column in seen]
    for channel, first, second, share in FELT:
        if second is None and (rate is None or len(found[first]) < 2):
            continue
        more = _rise(found[first], rate) if second is None else _product(found[first], found[second])
        left[channel] = [value - share * one for value, one in zip(left[channel], more, strict=True)]
    return left


def _settled(value: float, before: float) -> float:
    """NaN for what the last round still moved."""
    return value if abs(value - before) <= UNSETTLED * (1.0 + abs(value)) else math.nan


CONDITIONS = {"T": "temperature", "Vs": "supply", "t": "time"}
BINARY: Mapping[str, Any] = {
    "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b, "**": math.pow,
}  # fmt: skip
UNARY: Mapping[str, Any] = {
    "neg": lambda a: -a, "sin": math.sin, "cos": math.cos, "tan": math.tan, "exp": math.exp, "log": math.log,
    "sqrt": math.sqrt, "abs": abs, "sign": lambda a: float((a > 0.0) - (a < 0.0)),
}  # fmt: skip


def _less_written(
    left: list[list[float]], found: Sequence[Sequence[float]], conditions: Mapping[str, Sequence[float]]
) -> list[list[float]]:
    """Less what is felt by formulas, where all that they need is given."""
    given = {name: conditions[of] for name, of in CONDITIONS.items() if of in conditions}
    for channel, expression, sources in WRITTEN:
        signals = {**{name: found[source] for name, source in sources.items()}, **given}
        if all(name in signals for name in _names(expression)):
            more = [_value(expression, signals, n) for n in range(len(left[channel]))]
            left[channel] = [value - one for value, one in zip(left[channel], more, strict=True)]
    return left


def _names(expression: Any) -> list[str]:
    if isinstance(expression, tuple):
        return [name for part in expression[1:] for name in _names(part)]
    return [expression] if isinstance(expression, str) else []


def _value(expression: Any, signals: Mapping[str, Sequence[float]], n: int) -> float:
    """The value of arithmetic as nested tuples at sample n; NaN where it has none."""
    if isinstance(expression, str):
        return signals[expression][n]
    if not isinstance(expression, tuple):
        return float(expression)
    name, *parts = expression
    values = [_value(part, signals, n) for part in parts]
    try:
        return float((BINARY[name] if len(values) == 2 else UNARY[name])(*values))
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def _product(one: Sequence[float], other: Sequence[float]) -> list[float]:
    return [a * b for a, b in zip(one, other, strict=True)]


def _rise(signal: Sequence[float], rate: float | None) -> list[float]:
    """Derivative by differences over two samples, at the ends over one."""
    last = len(signal) - 1
    pairs = [(max(n - 1, 0), min(n + 1, last)) for n in range(last + 1)]
    return [(signal[b] - signal[a]) * (rate or math.nan) / (b - a) for a, b in pairs]
