"""A Python module without dependencies that applies a repaired model: the source of `corrected`, with its numbers.

import sim_cube_1_correction as unit
unit.apply({"unit_a_x": unit.counts_to_volts(counts), …}, rate=3125.0)
"""

from __future__ import annotations

import math
from importlib import resources
from typing import Any

from rig.correction.correction import Correction
from rig.export.correction_numbers import Numbers, half, heading, numbers_of, rows_apart, stays, stem, words_of
from rig.export.python_module import BEGIN, END, literal, quoted


def files(correction: Correction, rate: float | None = None) -> dict[str, bytes]:
    """The module by its file name. Raises BadInput for a model that holds no channel."""
    channels = numbers_of(correction, rate)
    source = resources.files("rig.export").joinpath("corrected.py").read_text("utf-8")
    before, rest = source.split('"""', 2)[2].split(BEGIN)
    numbers, after = rest.split(END)
    heads = {line.partition(":")[0]: line.partition(" = ")[0] for line in numbers.splitlines()}
    body = "\n".join(f"{heads[name]} = {text}" for name, text in _texts(correction, channels, rate).items())
    text = f"{quoted(_docstring(correction, channels, rate))}{before}{body}\n{after}"
    return {f"{stem(correction)}_correction.py": text.encode()}


def _texts(correction: Correction, channels: list[Numbers], rate: float | None) -> dict[str, str]:
    felt = [(one.channel, one.first, one.second, one.share) for one in correction.coupling.felt]
    provenance = {"unit": correction.unit, "simulated": correction.simulated, "notes": heading(correction)}
    return {
        "PROVENANCE": literal(provenance),
        "CHANNELS": literal({one.name: _channel(one) for one in channels}),
        "APART": repr(rows_apart(correction)),
        "FELT": repr(felt),
        "WRITTEN": repr([(one.channel, one.expression, dict(one.sources)) for one in correction.coupling.written]),
        "PASSES": repr(correction.coupling.passes),
        "RATE": repr(None if rate is None else float(rate)),
        "NOT_UNDONE": repr(stays(correction, rate)),
    }


def _channel(one: Numbers) -> dict[str, Any]:
    drifts = [{"of": d.of, "reference": d.reference, "gain": d.gain, "zero": d.zero, "shift": d.shift, "decay": d.decay}
              for d in one.drifts]  # fmt: skip
    bends = []
    for bend in one.bends:
        above, below = (tuple(None if math.isinf(n) else float(n) for n in half(side)) for side in bend.halves)
        bends.append({"shift": float(bend.shift), "above": above, "below": below})
    return {
        "quantity": one.quantity, "unit": one.unit, "sensitivity": one.sensitivity, "zero": one.zero,
        "u_sensitivity": one.u_sensitivity, "u_zero": one.u_zero, "lag": one.lag, "drifts": drifts, "bends": bends,
        "ahead": one.ahead, "taps": list(one.taps),
    }  # fmt: skip


def _docstring(correction: Correction, channels: list[Numbers], rate: float | None) -> list[str]:
    known = f"RATE is {rate:g} samples per second" if rate is not None else "made without a rate: lags stay in records"
    return [
        "Applies a repaired model to raw samples: counts_to_volts, apply, uncertainty.",
        "",
        *heading(correction),
        "",
        f"m/s² along and rad/s about the axes of the case; {known}. Standard library only, Python 3.10 or later.",
        "",
        *(words_of(one) for one in channels),
        "",
        *(f"Note: {one}" for one in stays(correction, rate)),
    ]
