"""How a cell of the fault matrix ended, by number.

Of every row that the calibration gives, without a flag or a failed verdict, the value is held against the truth: of
sensitivities, bandwidths and what a clean sensor has none of (couplings, nonlinearity) as the world was drawn, of all
else (zero outputs, noise) what the same procedure gives in the same world without the fault. A row is right within
twice its stated expanded uncertainty U (95 %) of what was drawn, or twice √(U² + U²) of what is found without the
fault. Then, the worst first:

- hang: it did not end, and was ended; traceback: it ended by an error that is not deliberate;
- silent: a row is wrong, and neither it nor a finding says so;
- unnamed: an error that does not name where; error: a deliberate one, exit 1, 2 or 3, that does;
- flagged: all wrong rows are flagged, fail, or are not determined; or a finding, or a row that is flagged or not
  determined where it was without the fault, says that something is wrong;
- harmless: no row is wrong, and no word is said.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from faulty_bench import Said

WITHIN = 2.0  # of a row's own expanded uncertainty
BAD = ("hang", "traceback", "silent", "unnamed")
OUTCOMES = (*BAD, "error", "flagged", "harmless")
DELIBERATE = frozenset({1, 2, 3})
PLACES = re.compile(
    r"analyzer|scope|recorder|vibrometer|cube|filter|encoder|turntable|platter|operator|bench|gateway|guard|pose|"
    r"unit_|gyro_|backup_|ldv|tag|supply|temperature| Hz|spin|rest|noise|cables"
)
NOTHING = ("cross_coupling", "nonlinearity", "quadratic", "cubic", "asymmetry")  # that a clean sensor has

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Outcome:
    """`worst` is the largest error of an untold row in units of what it may be off by; `words` say what it was."""

    kind: str
    words: str
    worst: float = 0.0


def judged(said: Said | None, clean: Sequence[Row], clean_flags: Sequence[str] = ()) -> Outcome:
    """The outcome; `said` is None for what did not end, `clean` are the rows without the fault."""
    if said is None:
        return Outcome("hang", "did not end")
    for code, stderr in ((said.code, said.stderr), (said.calibrated, said.calibrated_stderr)):
        if "Traceback" in stderr or code not in DELIBERATE | {0}:
            return Outcome("traceback", _last(stderr) or f"exit {code}")
    told_of_all = [flag for flag in said.flags if flag not in clean_flags]
    untold = [(off(row, said.truth, clean), row) for row in said.rows if not _told(row)]
    worst, at = max(((ratio, row) for ratio, row in untold), key=lambda one: one[0], default=(0.0, {"key": "-"}))
    if worst > 1.0 and not told_of_all:
        return Outcome("silent", _figures(at, said.truth, clean), worst)
    if said.code:
        words = _last(said.stderr)
        return Outcome("error" if PLACES.search(words) else "unnamed", words, worst)
    if words := "; ".join([*told_of_all, *_signs(said.rows, clean)]) or (_last(said.calibrated_stderr)):
        return Outcome("flagged", words, worst)
    return Outcome("harmless", f"worst of {len(untold)} rows: {_figures(at, said.truth, clean)}", worst)


def off(row: Row, truth: Mapping[str, Any], clean: Sequence[Row]) -> float:
    """Error of a row over what it may be off by; 0 for what has no value, infinite for what cannot be held to any."""
    if row["value"] is None:
        return 0.0
    right, u = _right(row, truth, clean)
    return abs(row["value"] - right) / (WITHIN * math.hypot(row["expanded"], u)) if math.isfinite(right) else 0.0


def _right(row: Row, truth: Mapping[str, Any], clean: Sequence[Row]) -> tuple[float, float]:
    """The right value and its own expanded uncertainty; NaN where there is none."""
    channel, _, measurand = row["key"].partition(".")
    if measurand.startswith("sensitivity") and channel in truth["sensitivity"]:
        return float(truth["sensitivity"][channel]), 0.0
    if measurand == "bandwidth" and channel in truth["pole"]:
        return float(truth["pole"][channel]), 0.0
    if measurand.startswith(NOTHING):
        return 0.0, 0.0
    for one in clean:
        if one["key"] == row["key"] and one["value"] is not None:
            return float(one["value"]), float(one["expanded"])
    return math.nan, 0.0


def _told(row: Row) -> bool:
    return row["value"] is None or row["status"] != "determined" or row["verdict"] in ("fail", "inconclusive")


def _signs(rows: Sequence[Row], clean: Sequence[Row]) -> Iterator[str]:
    """What rows say that they do not say without the fault."""
    before = {one["key"]: one for one in clean}
    now = {row["key"]: row for row in rows}
    for key, was in before.items():
        row = now.get(key)
        if row is None:
            if was["value"] is not None:
                yield f"{key}: no such row"
        elif row["value"] is None and was["value"] is not None and row["verdict"] is None and _noise(key):
            continue  # what a short record's noise shows of itself comes and goes
        elif (row["status"], row["verdict"]) != (was["status"], was["verdict"]) and _told(row):
            yield f"{key}: {row['verdict'] or row['status']}" + (f": {row['remarks'][-1]}" if row["remarks"] else "")


def _noise(key: str) -> bool:
    return key.endswith(("bias_instability", "random_walk", "noise_bandwidth"))


def _figures(row: Row, truth: Mapping[str, Any], clean: Sequence[Row]) -> str:
    if row.get("value") is None:
        return "none has a value"
    right, _ = _right(row, truth, clean)
    error = row["value"] - right
    return f"{row['key']} {row['value']:.5g} {row['unit']}, off by {error:.2g}, U {row['expanded']:.2g}"


def _last(stderr: str) -> str:
    lines = [line for line in stderr.strip().splitlines() if line.strip()]
    said = [line for line in lines if line.startswith(("error:", "NOT SAFE", "Error:"))]
    return " / ".join(said) or (lines[-1] if lines else "")
