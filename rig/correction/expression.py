"""Arithmetic as nested tuples, which numpy, Python without dependencies and C can all carry out.

("*", 0.001, ("**", "u", 2.0))      # 0.001·u²
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any, cast

import numpy as np

from rig.correction.inverse import Array, Expression

BINARY: Mapping[str, Callable[[Array, Array], Array]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "**": np.power,
}  # fmt: skip
UNARY: Mapping[str, Callable[[Array], Array]] = {
    "neg": operator.neg, "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log, "sqrt": np.sqrt,
    "abs": np.abs, "sign": np.sign,
}  # fmt: skip
C_NAMES = {"abs": "fabs"}


def value(of: Expression, signals: Mapping[str, Array]) -> Array:
    """Its value where signals have these; not finite where it has none."""
    with np.errstate(all="ignore"):
        return _value(of, signals)


def _value(of: Expression, signals: Mapping[str, Array]) -> Array:
    if isinstance(of, str):
        return signals[of]
    if not isinstance(of, tuple):
        return np.asarray(float(of))
    name, *parts = of
    arguments = [_value(part, signals) for part in parts]
    function = cast(Callable[..., Any], BINARY[name] if len(parts) == 2 else UNARY[name])
    return np.asarray(function(*arguments))


def names(of: Expression) -> Iterator[str]:
    """The signals in it."""
    if isinstance(of, str):
        yield of
    elif isinstance(of, tuple):
        for part in of[1:]:
            yield from names(part)


def in_c(of: Expression, signal: Callable[[str], str]) -> str:
    """The same for C, in double; `signal` gives the words for a signal, `sign` is a function of its own."""
    if isinstance(of, str):
        return signal(of)
    if not isinstance(of, tuple):
        return repr(float(of))
    name, *parts = of
    words = [in_c(part, signal) for part in parts]
    if name == "**":
        return f"pow({words[0]}, {words[1]})"
    if name == "neg":
        return f"(-{words[0]})"
    if len(words) == 2:
        return f"({words[0]} {name} {words[1]})"
    return f"{C_NAMES.get(name, name) if name != 'sign' else signal('sign')}({words[0]})"
