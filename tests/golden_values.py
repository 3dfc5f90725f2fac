"""The numbers of a few standard runs, kept in `tests/golden/`, and how close to them new ones have to be.

    python tests/golden_values.py                    # every value that differs at all, in units of its u
    python tests/golden_values.py --renew [NAME...]  # the same, and keep what is outside the tolerance

Everything is equal but for names of runs, paths and times: text and whole numbers exactly, other numbers to 1e-9 of
themselves or 1e-6 of their standard uncertainty, whichever is wider; uncertainties to 1e-6 of themselves. That is for
arithmetic that rounds in the same order, told by a digest of some sums, sines and decompositions. A processor with
other instructions or another linear algebra rounds elsewhere, and where an estimate is found by iterating the last
steps then stop elsewhere: see `ELSEWHERE`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded

import argparse
import hashlib
import json
import math
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import golden_runs
import numpy as np

KEPT = Path(__file__).with_name("golden")
RELATIVE, OF_U = 1e-9, 1e-6
ELSEWHERE = {"imported_rotation": 2e-5, "imported_motion": 2e-5}  # relative, on another processor; else `FAR`
FAR, OF_U_ELSEWHERE = 1e-8, 1e-5  # a model file's u has six digits
OF_U_OF_QUOTIENTS = 1e-2  # contributions to a budget, which are differences of two fits that each iterate
ZERO_ELSEWHERE = 1e-8  # V or SI; a zero output has no u of its own in a model file
RUN = re.compile(r"\d{4}-\d\d-\d\dT\d{6}-")  # what begins the name of a run
LEFT_OUT = {
    "figures", "path", "made", "when", "sources", "standards", "program", "runs", "run", "calibration", "history",
}  # fmt: skip
OWN_U = {"u", "expanded", "U", "uncertainty", "dof", "k", "coverageFactor", "shown_U"}
NAMED = ("key", "name")
ABSENT = "absent"
BLIND = "blind_slice"  # two minutes; held by the test of the blind slice, which diagnoses these worlds anyway
Leaf = str | int | float | bool | None


@dataclass(frozen=True)
class Change:
    """A value that is not what it was; `u` is its standard uncertainty, 0 if it has none."""

    where: str
    kept: Leaf
    found: Leaf
    u: float = 0.0

    @property
    def numbers(self) -> bool:
        return isinstance(self.kept, float) and isinstance(self.found, int | float)

    def within(self, relative: float) -> bool:
        """Whether it is close enough; never for text and whole numbers."""
        if not self.numbers:
            return False
        kept, found = float(self.kept or 0.0), float(self.found or 0.0)
        if not (math.isfinite(kept) and math.isfinite(found)):
            return kept == found
        if relative <= RELATIVE:
            return abs(found - kept) <= relative * abs(kept) + OF_U * self.u
        of_u = OF_U_OF_QUOTIENTS if self.where.endswith("/ contribution") else OF_U_ELSEWHERE
        zero = ZERO_ELSEWHERE if " / zero / " in self.where else 0.0
        return abs(found - kept) <= relative * abs(kept) + of_u * self.u + zero

    def __str__(self) -> str:
        if not self.numbers:
            return f"{self.where}: {self.kept!r} → {self.found!r}"
        by = float(self.found or 0.0) - float(self.kept or 0.0)
        size = (
            f"{by / self.u:+.2g} u" if self.u else f"{by / float(self.kept):+.2g} of itself" if self.kept else "was 0"
        )
        return f"{self.where}: {self.kept!r} → {self.found!r} ({size})"


def plain(value: Any) -> Any:
    """A value as it is kept: without paths, times and the dates in names; lists of named things by their names.

    What a contribution to a budget brings (its u times the sensitivity to it) stands in place of the sensitivity: that
    is a difference quotient, and means nothing where the contribution is nothing. It is judged by the result's u.
    """
    if isinstance(value, Mapping):
        return _dateless({str(key): plain(one) for key, one in _told(value).items() if key not in LEFT_OUT})
    if isinstance(value, list | tuple):
        named = _named(value)
        return {key: plain(one) for key, one in named.items()} if named else [plain(one) for one in value]
    return RUN.sub("", value) if isinstance(value, str) else value


def _dateless(value: Mapping[str, Any]) -> dict[str, Any]:
    """Without the dates in keys; two runs of one name are told apart by their order."""
    found: dict[str, Any] = {}
    for key, one in value.items():
        name = RUN.sub("", key)
        found[f"{name} ({sum(RUN.sub('', k) == name for k in value if k < key) + 1})" if name in found else name] = one
    return found


def _told(value: Mapping[Any, Any]) -> Mapping[Any, Any]:
    if not {"u", "sensitivity", "distribution"} <= set(value):
        return value
    rest = {key: one for key, one in value.items() if key != "sensitivity"}
    return {**rest, "contribution": value["u"] * value["sensitivity"]}


def _named(values: Sequence[Any]) -> dict[str, Any]:
    """A list by the names of its members; empty if they have none or share one."""
    told = [_keyed(one) if isinstance(one, Mapping) else {} for one in values]
    for name in NAMED:
        keys = [str(one[name]) for one in told if name in one]
        if keys and len(keys) == len(values) == len(set(keys)):
            rest = [{key: x for key, x in one.items() if key != name} for one in told]
            return dict(zip(keys, rest, strict=True))
    return {}


def _keyed(value: Mapping[Any, Any]) -> Mapping[Any, Any]:
    """A result of a calibration file has its key in two pieces."""
    if "measurand" in value and "channel" in value:
        return {"key": f"{value['channel']}.{value['measurand']}", **value}
    return value


def changes(kept: Any, found: Any, where: str = "", u: float = 0.0) -> Iterator[Change]:
    """Every leaf that differs at all. `u` is that of the nearest value around it."""
    if isinstance(kept, Mapping) and isinstance(found, Mapping):
        u = uncertainty(kept) or u
        for key in dict.fromkeys((*kept, *found)):
            place = f"{where} / {key}" if where else str(key)
            yield from changes(kept.get(key, ABSENT), found.get(key, ABSENT), place, _own(key, kept, u))
    elif isinstance(kept, list) and isinstance(found, list) and len(kept) == len(found):
        for n, (one, other) in enumerate(zip(kept, found, strict=True)):
            yield from changes(one, other, f"{where} / {n}", u)
    elif type(kept) is not type(found) or (kept != found and not (kept is found or _both_nan(kept, found))):
        yield Change(where, _short(kept), _short(found), u)


def _both_nan(kept: Any, found: Any) -> bool:
    return isinstance(kept, float) and isinstance(found, float) and math.isnan(kept) and math.isnan(found)


def _short(value: Any) -> Leaf:
    return value if isinstance(value, Leaf) else f"{type(value).__name__} of {len(value)}"


def uncertainty(values: Mapping[str, Any]) -> float:
    """Standard uncertainty of the value among these; 0 if none is stated."""
    if isinstance(values.get("u"), float):
        return float(values["u"])
    if isinstance(values.get("uncertainty"), float) and isinstance(values.get("coverageFactor"), float):
        return float(values["uncertainty"]) / float(values["coverageFactor"])
    expanded = values.get("shown_U")
    return expanded / 2.0 if isinstance(expanded, float) else 0.0


def _own(key: str, values: Mapping[str, Any], u: float) -> float:
    """What a leaf is judged by: an uncertainty by itself, what has its own by that, anything else by what is around."""
    own = values.get(f"u_{key}", values.get(key) if key in OWN_U or key.startswith(("u_", "uc_")) else None)
    return abs(own) if isinstance(own, float) and math.isfinite(own) else u


# what is kept


def arithmetic() -> str:
    """A digest of how sums, sines, exponentials and decompositions are rounded here."""
    x = np.linspace(-3.0, 3.0, 4001)
    square = np.cos(np.outer(x[:60], x[:40]) + x[:40] ** 2)
    results = [np.sin(x), np.exp(x), np.cumsum(x * x), np.array(x @ np.cos(x)), square.T @ square,
               *np.linalg.svd(square), np.linalg.inv(square.T @ square + np.eye(40)), np.fft.rfft(x)]  # fmt: skip
    return hashlib.sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in results)).hexdigest()[:12]


def files(scenario: str) -> dict[str, Path]:
    """Kept files of a scenario by what they hold."""
    return {path.stem.replace("_", " "): path for path in sorted((KEPT / scenario).glob("*.json"))}


def kept(scenario: str) -> dict[str, Any]:
    return {name: json.loads(path.read_text(encoding="utf-8")) for name, path in files(scenario).items()}


def same_arithmetic() -> bool:
    """Whether the values were kept by arithmetic that rounds as it does here."""
    return (KEPT / "arithmetic").read_text(encoding="utf-8").strip() == arithmetic()


def tolerance(scenario: str) -> float:
    """Relative."""
    return RELATIVE if same_arithmetic() else ELSEWHERE.get(scenario, FAR)


def keep(scenario: str, found: Mapping[str, Any]) -> None:
    (KEPT / scenario).mkdir(parents=True, exist_ok=True)
    for name, value in found.items():
        path = KEPT / scenario / f"{name.replace(' ', '_')}.json"
        path.write_text(_text(value) + "\n", encoding="utf-8")
    for name, path in files(scenario).items():
        if name not in found:
            path.unlink()


def _text(value: Any, depth: int = 0) -> str:
    """JSON with one line for what holds no further lists of things."""
    line = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, dict | list) or (depth and len(line) <= 110) or not value:
        return line
    pad = " " * (depth + 1)
    if isinstance(value, list):
        inner = [pad + _text(one, depth + 1) for one in value]
        return "[\n" + ",\n".join(inner) + f"\n{pad[1:]}]"
    if depth and not any(isinstance(one, dict | list) for one in value.values()):
        return line
    inner = [f"{pad}{json.dumps(key, ensure_ascii=False)}: {_text(one, depth + 1)}" for key, one in value.items()]
    return "{\n" + ",\n".join(inner) + f"\n{pad[1:]}}}"


def renewed(before: Any, now: Any, far: set[str], where: str = "") -> Any:
    """What is found now, but the kept value wherever that is close enough."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        return {
            key: renewed(before.get(key, ABSENT), one, far, f"{where} / {key}" if where else str(key))
            for key, one in now.items()
        }
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        return [renewed(a, b, far, f"{where} / {n}") for n, (a, b) in enumerate(zip(before, now, strict=True))]
    return now if where in far or type(before) is not type(now) else before


def measured(scenario: str, folder: Path) -> dict[str, Any]:
    """What a scenario gives now, as it would be kept."""
    if scenario == BLIND:
        import golden_blind  # stands on the program's modules, as the blind test does

        return as_json(golden_blind.kept_of([golden_blind.diagnosed(one) for one in golden_blind.answers()]))
    return as_json(_placeless(golden_runs.SCENARIOS[scenario](folder), str(folder)))


def _placeless(value: Any, folder: str) -> Any:
    """Texts without the folder in which everything was made."""
    if isinstance(value, Mapping):
        return {key: _placeless(one, folder) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_placeless(one, folder) for one in value]
    return value.replace(folder, "FOLDER") if isinstance(value, str) else value


def as_json(found: Mapping[str, Any]) -> dict[str, Any]:
    """As it would be read back: lists for tuples, text for keys."""
    return dict(json.loads(json.dumps(plain(found))))


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--renew", action="store_true", help="keep the values that are outside the tolerance")
    parser.add_argument("names", nargs="*", default=[], metavar="NAME", help="scenarios (all)")
    asked = parser.parse_args()
    if asked.renew and asked.names and not same_arithmetic():
        parser.error("found other arithmetic than that of the kept values, wanted --renew without names: all of them")
    for name in asked.names or (*golden_runs.SCENARIOS, BLIND):
        with tempfile.TemporaryDirectory() as folder:
            _looked_at(name, measured(name, Path(folder)), asked.renew)
    if asked.renew and not asked.names:
        (KEPT / "arithmetic").write_text(arithmetic() + "\n", encoding="utf-8")
    return 0


def _looked_at(name: str, found: dict[str, Any], renew: bool) -> None:
    before = kept(name)
    all_of_them = list(changes(before, found))
    far = [one for one in all_of_them if not one.within(tolerance(name))] if before else []
    print(f"{name}: {len(all_of_them)} of its values differ, {len(far)} by more than the tolerance")
    for one in far if renew else all_of_them:
        print(f"  {one}")
    if renew:
        near = before and same_arithmetic()
        keep(name, renewed(before, found, {one.where for one in far}) if near else found)


if __name__ == "__main__":
    sys.exit(main())
