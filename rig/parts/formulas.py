"""Shapes of a formula that are worth trying for what a model leaves over, without their coefficient."""

from __future__ import annotations

import itertools

PER_TURN = (*range(1, 17), 18, 20, 24)
_WAVES = tuple(itertools.product(("", "omega*"), ("sin", "cos")))

ANYWHERE = (
    "u**2", "u**3", "u**4", "u**5", "u*abs(u)", "abs(u)", "sqrt(abs(u))", "sign(u)*sqrt(abs(u))", "T", "T*u", "Vs",
    "Vs*u", "t", "t*u", "exp(-t/{tau})", "u*exp(-t/{tau})",
)  # fmt: skip
OF_SHAKER = (
    "log(f)*u", "f*u", "f**2*u", "u/f", "A", "A*u", "A**2", "f*A", "V", "V**2", "V*abs(V)", "V*f", "V/f",
    "x", "y", "z", "x**2", "y**2", "z**2",
)  # fmt: skip
OF_PLATTER = (
    "omega", "abs(omega)", "omega**2", "omega**3", "omega*abs(omega)", "sqrt(abs(omega))",
    "sign(omega)*sqrt(abs(omega))", "alpha", "x", "y", "z",
    *(f"{factor}{wave}({order}*theta)" for order in PER_TURN for factor, wave in _WAVES),
)  # fmt: skip
