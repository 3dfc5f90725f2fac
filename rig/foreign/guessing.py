"""A first draft of a manifest from a file alone, for a person to finish.

    draft = guess(Path("yaw.csv"), Path())
    print(draft.text)                     # YAML, each guess with its reason in a comment
    draft.to_fill                         # ("unit.serial", "provenance.source", …): what no file says

Names are believed first ("gyro_z_dps"), numbers second (accelerometers at rest show gravity), and a unit that neither
tells is left for the person. What looks wrong with the data is written at the top.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.errors import BadInput
from rig.foreign import readers as foreign_files
from rig.foreign import text_dialects, text_files
from rig.foreign.column_names import Named, named
from rig.foreign.drafting import Draft, body, head, to_fill
from rig.foreign.manifest import SI_OF, UNIT_KINDS
from rig.foreign.pairs import AXES, still_magnitude
from rig.foreign.readers import Csv
from rig.foreign.tables import Array, numbers
from rig.units import STANDARD_GRAVITY

FASTEST = 35.0  # rad/s: 2000 °/s, where common gyros end
TIMES = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9}
ROS = ("angular_velocity", "linear_acceleration")  # names of sensor_msgs/Imu, whose units are rad/s and m/s²
EVEN = 0.05  # of a step: how even stamps are that a rate stands for
POSES = 4  # directions of gravity that make a record a multi-position one


@dataclass(frozen=True)
class Guess:
    """A drafted manifest: its kind, its text, and the keys that only a person knows."""

    kind: str
    text: str
    to_fill: tuple[str, ...]


def guess(path: Path, folder: Path) -> Guess:
    """Draft a manifest for a file; its path is written as seen from `folder`. Raises BadInput if it cannot be read."""
    draft = _read(path, folder)
    for name, values in draft.columns.items():
        _place(draft, name, values)
    _time_of(draft)
    _uncertainties(draft)
    _one_device(draft)
    _without_axis(draft)
    _units_from_values(draft)
    _roles_and_kind(draft)
    lacking = tuple(to_fill(draft))
    return Guess(draft.kind[0], "\n".join([*head(draft, lacking), *body(draft, filled=False), ""]), lacking)


def _read(path: Path, folder: Path) -> Draft:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: found it unreadable ({error.strerror}), wanted a file of measurements") from error
    try:
        form = foreign_files.format_of(path.name)
        how = text_dialects.written(raw) if form == "csv" else Csv()
        there = foreign_files.names(raw, form, how)
        units = dict(zip(there, text_files.units(raw, how), strict=False)) if form == "csv" else {}
        columns, left_out, odd = _numbers(raw, form, there, how)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    if not columns:
        why = "; ".join(f"{name}: {why}" for name, why in left_out[:2])
        raise BadInput(f"{path}: found no column of numbers with a name of its own ({why}), wanted some")
    columns = {name: numbers(values) for name, values in columns.items()}
    label = re.sub(r"[^A-Za-z0-9 _-]+", "-", path.stem).strip("-_ ")[:60] or "import"
    where, said = os.path.relpath(path, folder), text_dialects.comments(raw, how) if form == "csv" else ()
    return Draft(where, label, form, how, columns, units, left_out=left_out, said=said, odd=odd)


def _numbers(
    raw: bytes, form: Any, there: Sequence[str], how: Csv
) -> tuple[dict[str, Array], list[tuple[str, str]], tuple[str, ...]]:
    """Columns of numbers by name, those that are none and why, and what is odd about the lines."""
    columns: dict[str, Array] = {}
    single = [name for name in there if name and there.count(name) == 1]
    left_out = [(name or "(no name)", "no name of its own") for name in dict.fromkeys(there) if name not in single]
    try:
        if single:
            table = foreign_files.read(raw, form, single, how)
            return {name: table.values[:, k] for k, name in enumerate(single)}, left_out, table.said
    except BadInput:
        pass  # some are text or of another length: one by one
    odd: list[str] = []
    for name in single:
        try:
            table = foreign_files.read(raw, form, [name], how)
            columns[name] = table.values[:, 0]
            odd += table.said
        except BadInput as error:
            left_out.append((name, f"not numbers ({error})"))
    longest = max((len(values) for values in columns.values()), default=0)
    short = [name for name, values in columns.items() if len(values) != longest]
    left_out += [(name, f"{len(columns[name])} numbers, the others have {longest}") for name in short]
    kept = {name: values for name, values in columns.items() if name not in short}
    return kept, left_out, tuple(dict.fromkeys(odd))


def _place(draft: Draft, name: str, values: Array) -> None:
    """A quantity by its name, or nothing that is known; time is chosen among all that is called so."""
    one = named(name, draft.units.get(name, ""))
    if one is None:
        draft.left_out.append((name, "the name says no quantity"))
    elif one.quantity == "left out":
        draft.left_out.append((name, one.why))
    elif one.quantity == "quaternion" and not _moves(values):
        draft.left_out.append((name, "an attitude that never changes"))
    elif one.quantity in ("time", "part of time"):
        (draft.parts if one.quantity == "part of time" else draft.times).append(one)
    else:
        draft.named.append(one)


def _moves(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 0 and float(np.ptp(known)) > 0.0


def _time_of(draft: Draft) -> None:
    """The column of time stamps: when it was measured before when it was logged; else a rate from its parts."""
    for one in sorted(draft.times, key=lambda one: not re.search(r"header|stamp", one.column.lower())):
        unit, why = _time_unit(one, draft.columns[one.column])
        if draft.time is not None or not _runs(draft.columns[one.column]):
            said = "does not run like time" if draft.time is None else "another time"
            draft.left_out.append((one.column, said))
        else:
            draft.time = (one.column, unit, why)
    draft.left_out += [(one.column, "a part of a time stamp") for one in draft.parts]
    if draft.time is None and len(draft.parts) == 2:
        whole = sum((draft.columns[one.column] * TIMES[one.unit] for one in draft.parts), np.zeros(1))
        steps = np.diff(whole)
        usual = float(np.median(steps)) if len(steps) else 0.0
        if usual > 0.0 and float(np.abs(steps - usual).max()) < EVEN * usual:
            both = " and ".join(one.column for one in draft.parts)
            draft.rate = (f"{1.0 / usual:.6g} Hz", f"{both} together run evenly; neither alone is the time, check")


def _runs(values: Array) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 1 and float(np.mean(steps >= 0.0)) > 0.95 and float(np.mean(steps > 0.0)) > 0.5


def _time_unit(one: Named, values: Array) -> tuple[str, str]:
    if one.unit:
        return one.unit, one.why
    steps = np.diff(values[np.isfinite(values)])
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 1.0
    for unit, scale in TIMES.items():
        if 10.0 <= 1.0 / (usual * scale) <= 2e4:
            rate = 1.0 / (usual * scale)
            return unit, f"{one.why}; no unit in it, {unit} makes {rate:.4g} Hz, check"
    return "s", f"{one.why}; no unit in it and none that makes a usual rate, check"


def _uncertainties(draft: Draft) -> None:
    """Join `maguncer` to `mag`."""
    by = {one.column: one for one in draft.named}
    for name in [one.column for one in draft.named if one.uncertainty_of]:
        stem = by[name].uncertainty_of
        owner = next((one for one in draft.named if one.column.lower() == stem), None)
        draft.named = [one for one in draft.named if one.column != name]
        if owner is None:
            draft.left_out.append((name, "an uncertainty of no column that is there"))
        else:
            place = draft.named.index(owner)
            draft.named[place] = replace(owner, uncertainty_column=name, why=f"{owner.why}; {name} for its uncertainty")


def _one_device(draft: Draft) -> None:
    """Of several devices in one file the first is taken: a manifest describes one."""
    seen: dict[tuple[str, str, str], str] = {}
    kept = []
    for one in draft.named:
        key = (one.quantity, one.axis, one.component)
        if (one.axis or one.component) and key in seen:
            draft.left_out.append((one.column, f"a second one beside {seen[key]}: a manifest describes one device"))
            continue
        seen.setdefault(key, one.column)
        kept.append(one)
    draft.named = kept


def _without_axis(draft: Draft) -> None:
    """What has no axis beside a whole triad is its magnitude, or another sensor."""
    for quantity in SI_OF:
        mine = [one for one in draft.named if one.quantity == quantity]
        for one in [o for o in mine if not o.axis and {other.axis for other in mine} > set(AXES)]:
            draft.named.remove(one)
            draft.left_out.append((one.column, f"{quantity} of no axis beside three that have one: a magnitude?"))


def _units_from_values(draft: Draft) -> None:
    draft.named = [one if one.unit or not UNIT_KINDS[one.quantity] else _with_unit(draft, one) for one in draft.named]


def _with_unit(draft: Draft, one: Named) -> Named:
    """The unit that the numbers speak for, with the reason; "" where they do not."""
    values = draft.columns[one.column]
    finite = values[np.isfinite(values)]
    largest = float(np.max(np.abs(finite), initial=0.0))
    if one.quantity in ("acceleration", "rate") and len(finite) and np.all(finite == np.rint(finite)) and largest > 20:
        return replace(one, unit="counts", why=f"{one.why}; whole numbers: counts")
    match one.quantity:
        case "acceleration":
            return _acceleration(draft, one)
        case "rate":  # a slow turn in °/s looks like a fast one in rad/s: only the person knows
            if largest <= FASTEST and all(any(word in name for name in draft.columns) for word in ROS):
                return replace(one, unit="rad/s", why=f"{one.why}; named as in ROS's Imu message: rad/s, check")
            unit = "°/s" if largest > FASTEST else ""
            why = f"reaches {largest:.4g}, too fast for rad/s" if unit else f"reaches {largest:.4g}: °/s or rad/s?"
            return replace(one, unit=unit, why=f"{one.why}; {why}")
        case "angle" | "phase":
            unit = "°" if largest > 4.0 * np.pi else "rad" if one.quantity == "phase" else ""
            so = f"so {unit}, check" if unit else "° or rad?"
            return replace(one, unit=unit, why=f"{one.why}; reaches {largest:.4g}, {so}")
        case "frequency":
            return replace(one, unit="Hz", why=f"{one.why}; taken as Hz, check")
        case "excitation":
            return replace(one, unit="m/s²", why=f"{one.why}; no unit in it, m/s² or g? check")
        case _:
            return replace(one, why=f"{one.why}; no unit in it")


def _acceleration(draft: Draft, one: Named) -> Named:
    """Three axes at rest show gravity; a single one says nothing."""
    triad = [c for axis in AXES for c in draft.named if c.quantity == "acceleration" and c.axis == axis]
    if len(triad) != 3:
        return replace(one, quantity="unstated", why=f"{one.why}; no unit in it, and one axis cannot tell")
    vector = np.column_stack([draft.columns[c.column] for c in triad])
    size = still_magnitude(vector[np.isfinite(vector).all(axis=1)])
    for unit, wanted_size in (("m/s²", STANDARD_GRAVITY), ("g", 1.0), ("mg", 1000.0)):
        if abs(size / wanted_size - 1.0) < 0.2:
            return replace(one, unit=unit, why=f"{one.why}; |a| at rest is {size:.4g}, so {unit}")
    return replace(one, unit="counts", why=f"{one.why}; |a| at rest is {size:.4g}, neither g nor m/s²: counts?")


def _roles_and_kind(draft: Draft) -> None:
    there = {one.quantity for one in draft.named}
    reference = [one for one in draft.named if one.role == "reference"]
    if "frequency" in there and ({"magnitude", "phase"} <= there or {"real", "imaginary"} <= there):
        draft.kind = ("response", "frequencies with magnitude and phase")
    elif "quaternion" in there:
        draft.kind = ("motion", "a track of attitude")
    elif "angle" in there:
        draft.kind = ("rotation", "an angle beside the device")
        draft.rotation = _axis(draft)
    elif any(one.quantity in ("acceleration", "unstated") for one in reference):
        draft.kind = ("sweep", "two accelerometers, one of them named as the base or reference")
    else:
        count = _directions(draft)
        draft.kind = ("poses", f"gravity from {count} directions") if count >= POSES else ("static", "no reference")
    if draft.kind[0] != "sweep":
        draft.named = [one for one in draft.named if one.role != "drive" or one.quantity == "voltage"]


def _axis(draft: Draft) -> tuple[str, bool, str] | None:
    """Axis of rotation: the gyro that follows the angle; upright if its accelerometer shows gravity all the time."""
    angle = next(one for one in draft.named if one.quantity == "angle")
    scale = np.pi / 180.0 if angle.unit != "rad" else 1.0
    step = np.diff(np.unwrap(_filled(draft.columns[angle.column]) * scale))
    best = (0.0, "")
    for one in draft.named:
        if one.quantity == "rate" and one.axis:
            smooth = np.ones(10) / 10.0
            rate = np.convolve(_filled(draft.columns[one.column])[1:], smooth, "same")
            turned = np.convolve(step, smooth, "same")
            if np.ptp(rate) > 0.0 and np.ptp(turned) > 0.0:
                both = np.corrcoef(turned, rate)[0, 1] * float(np.std(rate))
                best = max(best, (abs(float(both)), one.axis))
    if not best[1]:
        return None
    along = next((o for o in draft.named if o.quantity == "acceleration" and o.axis == best[1]), None)
    size = abs(_mean(draft.columns[along.column])) if along is not None else 0.0
    upright = any(abs(size / g - 1.0) < 0.2 for g in (STANDARD_GRAVITY, 1.0))
    lies = f"its accelerometer shows {size:.3g} on average: {'upright' if upright else 'lying'}"
    return best[1], upright, f"the {best[1]} gyro follows {angle.column}; {lies}"


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else 0.0


def _filled(values: Array) -> Array:
    """The number before in place of what is none; zeros where there is no number at all."""
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return np.zeros(len(values))
    return np.asarray(values[known[np.maximum(np.searchsorted(known, np.arange(len(values)), "right") - 1, 0)]])


def _directions(draft: Draft) -> int:
    """From how many of the six directions gravity comes in parts at rest."""
    triad = [o for axis in AXES for o in draft.named if o.quantity == "acceleration" and o.axis == axis]
    if len(triad) != 3:
        return 0
    vector = np.column_stack([draft.columns[one.column] for one in triad])
    vector = vector[np.isfinite(vector).all(axis=1)]
    vector = vector - (0.5 * (vector.max(axis=0) + vector.min(axis=0)) if triad[0].unit == "counts" else 0.0)
    count = len(vector) // 50
    if not count:
        return 0
    blocks = vector[: count * 50].reshape(count, 50, 3)
    spread = blocks.var(axis=1).sum(axis=1)
    means = blocks.mean(axis=1)[spread <= np.quantile(spread, 0.5)]
    main = np.argmax(np.abs(means), axis=1)
    return len({(int(k), bool(mean[k] > 0.0)) for k, mean in zip(main, means, strict=True)})
