"""A first draft of a manifest from a file alone, for a person to finish.

    draft = guess(Path("yaw.csv"), Path())
    print(draft.text)                     # YAML, each guess with its reason in a comment
    draft.to_fill                         # ("unit.serial", "provenance.source", …): what no file says

Names are believed first ("gyro_z_dps"), numbers second (accelerometers at rest show gravity), and a unit that neither
tells is left for the person. What looks wrong with the data is written at the top.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rig.errors import BadInput
from rig.foreign import readers as foreign_files
from rig.foreign.checks import findings
from rig.foreign.column_names import Named, named
from rig.foreign.importing import foreign, rate_of, wanted
from rig.foreign.manifest import UNIT_KINDS, Manifest
from rig.foreign.pairs import AXES, still_magnitude
from rig.foreign.readers import Csv
from rig.foreign.tables import Array, Table, numbers
from rig.units import KINDS, STANDARD_GRAVITY

FASTEST = 35.0  # rad/s: 2000 °/s, where common gyros end
DELIMITERS = (",", ";", "\t", "|", " ")
FILLED = {"serial": "unknown", "source": "unknown", "licence": "unknown", "rate": "100 Hz"}
NO_TEXT = ("y", "n", "yes", "no", "on", "off", "true", "false", "null", "nan")
POSES = 4  # directions of gravity that make a record a multi-position one


@dataclass(frozen=True)
class Guess:
    """A drafted manifest: its kind, its text, and the keys that only a person knows."""

    kind: str
    text: str
    to_fill: tuple[str, ...]


@dataclass
class Draft:
    """What is known so far; `why` goes into comments."""

    file: str
    label: str
    form: str
    how: Csv
    columns: dict[str, Array]
    named: list[Named] = field(default_factory=list)
    left_out: list[tuple[str, str]] = field(default_factory=list)
    said: tuple[str, ...] = ()  # comments at the head of the file
    time: tuple[str, str, str] | None = None  # column, unit, why
    kind: tuple[str, str] = ("static", "")
    rotation: tuple[str, bool, str] | None = None


def guess(path: Path, folder: Path) -> Guess:
    """Draft a manifest for a file; its path is written as seen from `folder`. Raises BadInput if it cannot be read."""
    draft = _read(path, folder)
    for name, values in draft.columns.items():
        _place(draft, name, values)
    _uncertainties(draft)
    _one_device(draft)
    _units_from_values(draft)
    _roles_and_kind(draft)
    to_fill = tuple(_to_fill(draft))
    return Guess(draft.kind[0], "\n".join([*_head(draft, to_fill), *_body(draft, filled=False), ""]), to_fill)


def _read(path: Path, folder: Path) -> Draft:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: found it unreadable ({error.strerror}), wanted a file of measurements") from error
    try:
        form = foreign_files.format_of(path.name)
        how = written(raw) if form == "csv" else Csv()
        there = foreign_files.names(raw, form, how)
        columns, left_out = _numbers(raw, form, there, how)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    if not columns:
        raise BadInput(f"{path}: found no column of numbers with a name of its own, wanted some")
    columns = {name: numbers(values) for name, values in columns.items()}
    label = re.sub(r"[^A-Za-z0-9 _-]+", "-", path.stem).strip("-_ ")[:60] or "import"
    where, said = os.path.relpath(path, folder), _comments(raw, form, how)
    return Draft(where, label, form, how, columns, left_out=left_out, said=said)


def _comments(raw: bytes, form: str, how: Csv) -> tuple[str, ...]:
    """What a text file says in comments before its numbers; often the sampling interval."""
    if form != "csv" or not how.comment:
        return ()
    lines = raw[:4000].decode("utf-8-sig", "replace").splitlines()[:10]
    return tuple(line.strip()[:160] for line in lines if line.lstrip().startswith(how.comment))


def written(raw: bytes) -> Csv:
    """How a text file is written, from its first lines: delimiter, comment, header, decimal sign."""
    text = raw[:20_000].decode("utf-8-sig", "replace").splitlines()[:60]
    comment = next((sign for sign in ("#", "%") if text and text[0].lstrip().startswith(sign)), "#")
    lines = [line for line in text if line.strip() and not line.lstrip().startswith(comment)]
    lines = lines[:-1] if len(lines) > 2 else lines or text  # the last one may be cut
    best = max(DELIMITERS, key=lambda sign: _splits(lines, sign))
    cells = [cell for line in lines[1:] for cell in _cut(line, best)]
    commas = best != "," and sum(bool(re.fullmatch(r"[-+]?\d+,\d+", cell)) for cell in cells) > 0.2 * len(cells)
    if _names_in_comment(text, lines, comment, best, commas):
        return Csv(best, "", True, "," if commas else ".")
    header = any(cell and not _is_number(cell, commas) for cell in _cut(lines[0], best))
    return Csv(best, comment, header, "," if commas else ".")


def _cut(line: str, sign: str) -> list[str]:
    return [cell.strip().strip('"') for cell in line.split(sign if sign != " " else None)]


def _names_in_comment(text: Sequence[str], lines: Sequence[str], comment: str, sign: str, commas: bool) -> bool:
    """Whether the only comment is a header: as many cells as the rows below it, which are all numbers."""
    alone = sum(line.lstrip().startswith(comment) for line in text) == 1 and text[0].lstrip().startswith(comment)
    numbers = all(_is_number(cell, commas) for cell in _cut(lines[0], sign))
    return alone and numbers and sign != " " and len(_cut(text[0], sign)) == len(_cut(lines[0], sign)) > 1


def _splits(lines: Sequence[str], sign: str) -> tuple[int, float, int]:
    """How well a delimiter cuts lines: everywhere into the same number of cells, into numbers, into many."""
    cut = [_cut(line, sign) for line in lines]
    rows = cut[1:] or cut
    alike = len({len(row) for row in rows}) == 1 and len(rows[0]) > 1
    same = alike and len(cut[0]) == len(rows[0])  # a decimal comma cuts rows, but not the header
    cells = [cell for row in rows for cell in row]
    numbers = sum(_is_number(cell, sign != ",") for cell in cells) / len(cells)
    return 2 * same + alike, round(numbers, 1), len(rows[0]) if sign != " " else 1


def _is_number(cell: str, commas: bool) -> bool:
    try:
        float(cell.replace(",", ".") if commas else cell)
    except ValueError:
        return cell.lower() in foreign_files.NOT_A_NUMBER
    return True


def _numbers(raw: bytes, form: Any, there: Sequence[str], how: Csv) -> tuple[dict[str, Array], list[tuple[str, str]]]:
    """Columns of numbers by name, and those that are none."""
    columns: dict[str, Array] = {}
    left_out = []
    single = [name for name in there if name and there.count(name) == 1]
    left_out += [(name or "(no name)", "no name of its own") for name in dict.fromkeys(there) if name not in single]
    try:
        table = foreign_files.columns(raw, form, single, how) if single else np.empty((0, 0))
        return {name: table[:, k] for k, name in enumerate(single)}, left_out
    except BadInput:
        pass  # some are text or of another length: one by one
    for name in single:
        try:
            columns[name] = foreign_files.columns(raw, form, [name], how)[:, 0]
        except BadInput:
            left_out.append((name, "not numbers"))
    longest = max((len(values) for values in columns.values()), default=0)
    short = [name for name, values in columns.items() if len(values) != longest]
    left_out += [(name, f"{len(columns[name])} numbers, the others have {longest}") for name in short]
    return {name: values for name, values in columns.items() if name not in short}, left_out


def _place(draft: Draft, name: str, values: Array) -> None:
    """Time, a quantity by its name, or nothing that is known."""
    one = named(name)
    if one is None:
        draft.left_out.append((name, "the name says no quantity"))
    elif one.quantity == "time":
        unit, why = _time_unit(one, values)
        if draft.time is not None or not _runs(values):
            draft.left_out.append((name, "does not run like time" if draft.time is None else "another time"))
        else:
            draft.time = (name, unit, why)
    elif one.quantity == "left out":
        draft.left_out.append((name, one.why))
    else:
        draft.named.append(one)


def _runs(values: Array) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 1 and float(np.mean(steps >= 0.0)) > 0.95 and float(np.mean(steps > 0.0)) > 0.5


def _time_unit(one: Named, values: Array) -> tuple[str, str]:
    if one.unit:
        return one.unit, one.why
    steps = np.diff(values[np.isfinite(values)])
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 1.0
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)):
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


def _to_fill(draft: Draft) -> Iterator[str]:
    yield from ("unit.serial", "provenance.source", "provenance.licence")
    if draft.kind[0] != "response" and draft.time is None:
        yield "time.rate"
    if draft.kind[0] == "rotation" and draft.rotation is None:
        yield "rotation.axis, rotation.upright"
    for one in draft.named:
        if one.unit == "counts":
            yield f"sensitivity of {one.column}"
        elif not one.unit and UNIT_KINDS[one.quantity]:
            yield f"unit of {one.column}"
    if draft.kind[0] == "motion" and not any(one.quantity == "position" for one in draft.named):
        yield "a column of position"
    if not any(one.role == "device" for one in draft.named):
        yield "a column of the device"


def _head(draft: Draft, to_fill: Sequence[str]) -> Iterator[str]:
    rows = len(next(iter(draft.columns.values())))
    yield f"# Drafted from {draft.file} ({rows} rows). Every guess has its reason; check them all."
    yield f"# For you to fill in: {'; '.join(to_fill)}."
    yield from (f"# the file says: {line.lstrip(draft.how.comment).strip()}" for line in draft.said)
    for text in _looked_at(draft):
        yield f"# found: {text}"


def _looked_at(draft: Draft) -> Iterator[str]:
    """Sampling rate, and what looks wrong with the data, if the draft is a manifest once it is filled in."""
    if not draft.named:
        return
    body = yaml.safe_load("\n".join(_body(draft, filled=True)))
    made = Manifest.model_validate_json(json.dumps(body), strict=True)
    if any(name not in draft.columns for name in wanted(made)):
        return
    values = np.column_stack([draft.columns[name] for name in wanted(made)])
    table = Table(draft.label, wanted(made), values, {}, False)
    data = foreign(made, [table])
    rate = rate_of(data, table)
    if draft.time is not None and rate:
        yield f"{rate:.6g} samples per second"
    scaled = not any(one.unit == "counts" or (not one.unit and UNIT_KINDS[one.quantity]) for one in draft.named)
    yield from (one.text for one in findings(data) if scaled or one.kind_of != "unit")


def _body(draft: Draft, *, filled: bool) -> Iterator[str]:
    """The manifest's lines; `filled` with something in place of what only a person knows."""
    blank = FILLED if filled else dict.fromkeys(FILLED, "")
    yield "format: 1"
    yield f"kind: {draft.kind[0]}  # guess: {draft.kind[1]}"
    yield f"label: {_text(draft.label)}"
    yield f'unit: {{serial: {_text(blank["serial"])}, model: ""}}  # fill in: names the device; its runs share a model'
    yield "provenance:"
    yield f"  source: {_text(blank['source'])}  # fill in: where the data come from, so that anybody can find them"
    yield f"  licence: {_text(blank['licence'])}  # fill in"
    yield f"files: [{{path: {_text(draft.file)}, label: {_text(draft.label)}}}]"
    yield from _reading(draft)
    yield from _time(draft, blank)
    if draft.rotation is not None:
        axis, upright, why = draft.rotation
        yield f"rotation: {{axis: {axis}, upright: {str(upright).lower()}}}  # guess: {why}"
    if draft.kind[0] == "motion":
        yield "pose: {quaternion: body_to_world, up: z}  # guess: the usual way round, check"
    if draft.kind[0] == "sweep":
        yield "# mains: 50 Hz  # check: yours, if the sockets hum; it tells the recorder's clock from the drive's"
        yield "# settings of a file go beside its label: settings: {frequency: 5 Hz, level: low}"
    yield "columns:"
    yield from (_column(draft, one, filled) for one in draft.named)
    yield from (f"# left out: {name}: {why}" for name, why in draft.left_out)


def _reading(draft: Draft) -> Iterator[str]:
    how, parts = draft.how, [f"format: {draft.form}"]
    if draft.form == "csv":
        parts += [f"{key}: {_text(getattr(how, key))}" for key in ("delimiter", "comment", "decimal")]
        yield f"reading: {{{', '.join(parts)}, header: {str(how.header).lower()}}}  # guess: from the first lines"


def _time(draft: Draft, blank: Mapping[str, str]) -> Iterator[str]:
    if draft.kind[0] == "response":
        return
    if draft.time is None:
        yield f"time: {{rate: {_text(blank['rate'])}}}  # fill in: no column of time was found"
    else:
        column, unit, why = draft.time
        yield f"time: {{column: {_text(column)}, unit: {_text(unit)}}}  # guess: {why}"


def _column(draft: Draft, one: Named, filled: bool) -> str:
    why = one.why
    parts = [f"column: {_text(one.column)}", f"quantity: {one.quantity}"]
    if one.unit == "counts":
        zero, because = _zero(draft, one)
        per = "m/s²" if one.quantity == "acceleration" else "rad/s"
        parts += [f"sensitivity: {_text(f'1 counts per {per}' if filled else '')}", f"zero: {zero}"]
        why = f"{why}; {because}"
    elif UNIT_KINDS[one.quantity]:
        parts.append(f"unit: {_text(one.unit or (KINDS[UNIT_KINDS[one.quantity]].si.symbol if filled else ''))}")
    parts += [f"axis: {one.axis}"] if one.axis and one.quantity != "quaternion" else []
    parts += [f"component: {one.component}"] if one.component else []
    parts += [f"role: {one.role}"] if one.role != "device" else []
    parts += [f"uncertainty_column: {_text(one.uncertainty_column)}"] if one.uncertainty_column else []
    return f"- {{{', '.join(parts)}}}  # guess: {why}"


def _zero(draft: Draft, one: Named) -> tuple[int, str]:
    """What counts stand for nothing: the middle of 12, 16 or 24 bits if they are never negative, else 0."""
    values = draft.columns[one.column]
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    for bits in (12, 16, 24):
        if low >= 0.0 and 2 ** (bits - 1) < high < 2**bits:
            return 2 ** (bits - 1), f"{low:.0f} to {high:.0f}: {bits} bits around {2 ** (bits - 1)}, check"
    return 0, f"{low:.0f} to {high:.0f}: around 0, check"


def _text(value: str) -> str:
    """A YAML text: plain where that is the same, else in quotes."""
    plain = re.fullmatch(r"[A-Za-z_][A-Za-z0-9_./-]*|°(/s)?|m/s²", value) and value.lower() not in NO_TEXT
    return value if plain else json.dumps(value, ensure_ascii=False)
