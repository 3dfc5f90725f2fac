"""SI numbers as laboratories print them: the unit on paper, and as many digits as the uncertainty allows."""

from __future__ import annotations

import math
from collections.abc import Mapping

G = 9.80665  # m/s², the unit
DEGREE = math.pi / 180.0

# SI unit: (unit on paper, how many of it make one SI unit)
SHOWN: Mapping[str, tuple[str, float]] = {
    "V/(m/s²)": ("mV/g", 1e3 * G),
    "V/(rad/s)": ("mV/(°/s)", 1e3 * DEGREE),
    "m/s²": ("mg", 1e3 / G),
    "rad/s": ("°/s", 1.0 / DEGREE),
    "(m/s²)/√Hz": ("µg/√Hz", 1e6 / G),
    "(rad/s)/√Hz": ("(°/s)/√Hz", 1.0 / DEGREE),
    "(m/s²)·√Hz": ("mg·√Hz", 1e3 / G),
    "(rad/s)·√Hz": ("(°/s)·√Hz", 1.0 / DEGREE),
    "rad": ("°", 1.0 / DEGREE),
    "s": ("ms", 1e3),
    "1": ("%", 1e2),
    "V": ("V", 1.0),
    "Hz": ("Hz", 1.0),
    "1/(m/s²)": ("%/g", 1e2 * G),
    "1/(rad/s)": ("%/(100 °/s)", 1e4 * DEGREE),
    "1/(rad/s)²": ("%/(100 °/s)²", 1e6 * DEGREE**2),
}


def rounded(value: float, expanded: float) -> tuple[str, str]:
    """Both as text: U to two significant digits, the value to the same place (GUM 7.2.6)."""
    if not (math.isfinite(expanded) and expanded > 0.0):
        return f"{value:.6g}", f"{expanded:.2g}"
    places = 1 - math.floor(math.log10(float(f"{expanded:.1e}")))
    if places >= 0:
        return f"{value:.{places}f}", f"{expanded:.{places}f}"
    step = 10.0**-places
    return f"{round(value / step) * step:.0f}", f"{round(expanded / step) * step:.0f}"
