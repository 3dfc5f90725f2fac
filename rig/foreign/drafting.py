"""What is known of a file so far, and how it is written down: a manifest with the reason of each guess beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import yaml

from rig.foreign.checks import findings
from rig.foreign.column_names import Named
from rig.foreign.importing import foreign, rate_of, wanted
from rig.foreign.manifest import SI_OF, UNIT_KINDS, Manifest
from rig.foreign.readers import Csv
from rig.foreign.tables import Array, Table
from rig.units import KINDS

FILLED = {"serial": "unknown", "source": "unknown", "licence": "unknown", "rate": "100 Hz"}
NO_TEXT = ("y", "n", "yes", "no", "on", "off", "true", "false", "null", "nan")


@dataclass
class Draft:
    """What is known so far; `why` goes into comments."""

    file: str
    label: str
    form: str
    how: Csv
    columns: dict[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)  # as the file states them beside the names
    named: list[Named] = field(default_factory=list)
    left_out: list[tuple[str, str]] = field(default_factory=list)
    said: tuple[str, ...] = ()  # comments at the head of the file
    odd: tuple[str, ...] = ()  # lines that hold something else than numbers
    time: tuple[str, str, str] | None = None  # column, unit, why
    rate: tuple[str, str] | None = None  # in place of a column: quantity, why
    times: list[Named] = field(default_factory=list)
    parts: list[Named] = field(default_factory=list)  # columns that hold a part of a time stamp each
    kind: tuple[str, str] = ("static", "")
    rotation: tuple[str, bool, str] | None = None


def to_fill(draft: Draft) -> Iterator[str]:
    """Keys that only a person knows."""
    yield from ("unit.serial", "provenance.source", "provenance.licence")
    if draft.kind[0] != "response" and draft.time is None and draft.rate is None:
        yield "time.rate"
    if draft.kind[0] == "rotation" and draft.rotation is None:
        yield "rotation.axis, rotation.upright"
    for one in draft.named:
        if one.unit == "counts":
            yield f"sensitivity of {one.column}"
        elif not one.unit and UNIT_KINDS[one.quantity]:
            yield f"unit of {one.column}"
        if _needs_axis(draft, one):
            yield f"axis of {one.column}"
    if draft.kind[0] == "motion" and not any(one.quantity == "position" for one in draft.named):
        yield "a column of position"
    if not any(one.role == "device" for one in draft.named):
        yield "a column of the device"


def _needs_axis(draft: Draft, one: Named) -> bool:
    device = one.role == "device" and one.quantity in SI_OF
    return not one.axis and (device or one.quantity == "position") and draft.kind[0] not in ("response", "sweep")


def head(draft: Draft, lacking: Sequence[str]) -> Iterator[str]:
    """Comments above the manifest: what is lacking, what the file says, and what looks wrong with its data."""
    rows = len(next(iter(draft.columns.values())))
    yield f"# Drafted from {draft.file} ({rows} rows). Every guess has its reason; check them all."
    yield f"# For you to fill in: {'; '.join(lacking)}."
    yield from (f"# the file says: {line.lstrip(draft.how.comment).strip()}" for line in draft.said)
    yield from (f"# found: {text}" for text in draft.odd)
    for text in _looked_at(draft):
        yield f"# found: {text}"


def _looked_at(draft: Draft) -> Iterator[str]:
    """Sampling rate, and what looks wrong with the data, if the draft is a manifest once it is filled in."""
    if not draft.named:
        return
    filled = yaml.safe_load("\n".join(body(draft, filled=True)))
    made = Manifest.model_validate_json(json.dumps(filled), strict=True)
    if any(name not in draft.columns for name in wanted(made)):
        return
    values = np.column_stack([draft.columns[name] for name in wanted(made)])
    table = Table(draft.label, wanted(made), values, {}, False)
    data = foreign(made, [table])
    rate = rate_of(data, table)
    if draft.time is not None and rate:
        yield f"{rate:.6g} samples per second"
    scaled = not any(one.unit == "counts" or (not one.unit and UNIT_KINDS[one.quantity]) for one in draft.named)
    yield from (one.text for one in findings(data) if scaled or one.kind != "unit")


def body(draft: Draft, *, filled: bool) -> Iterator[str]:
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
        parts += [f"header: {str(how.header).lower()}"]
        parts += [f"skip: {how.skip}"] if how.skip else []
        parts += ["units: true"] if how.units else []
        yield f"reading: {{{', '.join(parts)}}}  # guess: from the first lines"


def _time(draft: Draft, blank: Mapping[str, str]) -> Iterator[str]:
    if draft.kind[0] == "response":
        return
    if draft.time is None and draft.rate is not None:
        yield f"time: {{rate: {_text(draft.rate[0])}}}  # guess: {draft.rate[1]}"
    elif draft.time is None:
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
    parts += [f"axis: {'x' if filled else _text('')}"] if _needs_axis(draft, one) else []
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
