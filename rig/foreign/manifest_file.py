"""A manifest as a file: read with every mistake that it has, by line, column and key.

Types are checked by the classes of `rig.foreign.manifest`; here is what they cannot say. What depends on the kind of
data alone stands in its `KINDS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Set
from pathlib import Path

from rig import units
from rig.errors import ConfigError, Problem
from rig.foreign.manifest import KINDS, SI_OF, Manifest, SheetNoise, per
from rig.yaml import config
from rig.yaml.document import Document


def load(path: Path) -> Manifest:
    """Read a manifest. Raises ConfigError that names every mistake by file, line, column and key."""
    document = config.read(path)
    made = config.validate(document, Manifest)
    problems = sorted(mistakes(document, made))
    if problems:
        raise ConfigError(problems)
    return made


def mistakes(document: Document, made: Manifest) -> Iterator[Problem]:
    """What the types cannot say."""
    yield from _of_columns(document, made)
    yield from _of_kind(document, made)
    yield from _of_rotation(document, made)
    yield from _unread(document, made)
    if made.reading.decimal == made.reading.delimiter:
        yield document.problem(
            ("reading",), "found the comma as delimiter and as decimal sign, wanted another delimiter"
        )
    if made.time is not None:
        given = [made.time.column is not None, made.time.rate is not None, made.time.interval is not None]
        if sum(given) != 1:
            yield document.problem(("time",), f"found {sum(given)} of column, rate and interval, wanted one")
        elif made.time.unit not in units.KINDS["time"].units:
            yield document.problem(("time", "unit"), f"found '{made.time.unit}', wanted a unit such as 's' or 'ms'")


def _of_columns(document: Document, made: Manifest) -> Iterator[Problem]:
    names: set[str] = set()
    for number, one in enumerate(made.columns):
        at = ("columns", number)
        if one.channel in names:
            yield document.problem(at, f"found the channel '{one.channel}' twice, wanted another name")
        names.add(one.channel)
        kind = one.unit_kind
        if one.sensitivity is not None:
            try:
                per(one.sensitivity, one.quantity)
            except ValueError as error:
                yield document.problem((*at, "sensitivity"), str(error))
        elif kind and one.unit not in units.KINDS[kind].units:
            wanted = units.KINDS[kind]
            yield document.problem((*at, "unit"), f"found '{one.unit}', wanted the unit of {wanted.wanted}")
        if one.uncertainty is not None and (said := _wrong(one.uncertainty, kind)):
            yield document.problem((*at, "uncertainty"), said)
        if one.noise is not None and (said := _wrong_noise(one.noise, one.quantity)):
            yield document.problem((*at, "noise"), said)
        needs_axis = (one.role == "device" and one.quantity in SI_OF) or one.quantity == "position"
        if needs_axis and one.axis is None and KINDS[made.kind].axes:
            yield document.problem((*at, "axis"), "found nothing, wanted x, y or z")
        if one.quantity == "quaternion" and one.component is None:
            yield document.problem((*at, "component"), "found nothing, wanted w, x, y or z")


def _wrong_noise(noise: SheetNoise, quantity: str) -> str:
    """What is wrong with a data sheet's noise, "" if nothing."""
    if noise.corner is not None and not 0.0 < noise.corner[0] <= noise.corner[1]:
        low, high = noise.corner
        return f"found a corner from {low:g} to {high:g} Hz, wanted one that rises from above zero"
    return "" if quantity not in SI_OF else _wrong(noise.density, f"{quantity}_density")


def _wrong(text: str, kind: str) -> str:
    """What is wrong with a quantity in text, "" if nothing."""
    try:
        units.parse(text, kind or "ratio")
    except units.UnitError as error:
        return str(error)
    return ""


def _of_kind(document: Document, made: Manifest) -> Iterator[Problem]:
    device = made.of("device")
    if not device:
        yield document.problem(("columns",), "found no column of the device, wanted one with role: device")
    for role, quantity in KINDS[made.kind].wanted:
        if not made.of(role, quantity or None):
            of = f" of {quantity}" if quantity else ""
            yield document.problem(("columns",), f"found no {role} column{of}, wanted one for a {made.kind}")
    if made.kind == "response":
        there = {one.quantity for one in device}
        if not ({"magnitude", "phase"} <= there or {"real", "imaginary"} <= there):
            yield document.problem(("columns",), "found no response, wanted magnitude and phase or real and imaginary")
    if made.kind == "rotation":
        if made.rotation is None:
            yield document.problem((), "found no key 'rotation', wanted it to say the axis")
        quantities = {one.quantity for one in made.of("reference")}
        if not ({"angle"} <= quantities or {"line_a"} <= quantities):
            yield document.problem(("columns",), "found no reference of angle, wanted one, or an encoder's line_a")
        elif "angle" not in quantities and made.rotation is not None and made.rotation.lines is None:
            yield document.problem(("rotation", "lines"), "found nothing, wanted the encoder's lines per revolution")
    if made.kind == "motion":
        yield from _of_motion(document, made)
    if KINDS[made.kind].timed and made.time is None:
        yield document.problem((), "found no key 'time', wanted a column of time stamps, a rate or an interval")
    if len(made.files) > 1 and made.segments and "segments" in KINDS[made.kind].keys:
        yield document.problem(("segments",), f"found segments and {len(made.files)} files, wanted one file")
    for number, one in enumerate(made.segments):
        if one.last <= one.first:
            yield document.problem(("segments", number, "last"), f"found {one.last}, wanted more than {one.first}")
        if (one.turn is None) != (one.angle is None):
            yield document.problem(("segments", number), "found turn or angle alone, wanted both")


def _of_rotation(document: Document, made: Manifest) -> Iterator[Problem]:
    """Axes and radius of a rotation that do not go together, and segments that do not lie on its axis."""
    turned = made.rotation
    if made.kind != "rotation" or turned is None:
        return
    for key in ("outward", "radius_uncertainty"):
        if getattr(turned, key) and not turned.radius:
            yield document.problem(("rotation", key), f"found '{getattr(turned, key)}' without a radius, wanted one")
    if turned.outward is not None and turned.outward[1] == turned.axis:
        yield document.problem(
            ("rotation", "outward"), f"found '{turned.outward}', wanted an axis across {turned.axis}"
        )
    if turned.lines is not None and made.of("reference", "angle"):
        yield document.problem(("rotation", "lines"), "found lines beside an angle, wanted one of them")
    for number, one in enumerate(made.segments):
        if one.turn is not None:
            yield document.problem(("segments", number, "turn"), f"found '{one.turn}', wanted nothing in a rotation")
        if one.up is not None and (one.up[1] == turned.axis) != turned.upright:
            wanted = f"+{turned.axis} or -{turned.axis}" if turned.upright else f"an axis across {turned.axis}"
            yield document.problem(("segments", number, "up"), f"found '{one.up}', wanted {wanted}")


def _unread(document: Document, made: Manifest) -> Iterator[Problem]:
    """Keys that would change nothing."""
    inner = {f"gravity.{name}" for name in made.gravity.model_fields_set}
    inner |= {f"compared.{name}" for name in made.compared.model_fields_set}
    for key, wanted in _unread_of_file(made.kind, made.model_fields_set | inner):
        yield document.problem(tuple(key.split(".")), f"found '{key.split('.')[-1]}', {wanted}")
    for number, one in enumerate(made.columns):
        at = ("columns", number)
        for key, wanted in _unread_of_column(made.kind, one.role, one.quantity, one.model_fields_set):
            yield document.problem((*at, key), f"found '{key}', {wanted}")
        if "coverage" in one.model_fields_set and one.uncertainty is None and one.uncertainty_column is None:
            yield document.problem((*at, "coverage"), "found it alone, wanted an uncertainty that it covers")
        if one.uncertainty is not None and one.uncertainty_column is not None:
            yield document.problem((*at, "uncertainty"), "found it beside uncertainty_column, wanted one of them")
    yield from _together(document, made)
    base = made.time
    if base is not None and base.column is None:
        for key in sorted(base.model_fields_set & {"unit", "jitter"}):
            yield document.problem(("time", key), f"found '{key}' without a column of time stamps, wanted one")


def _together(document: Document, made: Manifest) -> Iterator[Problem]:
    """What belongs to a whole reference, of which one column says it and another says otherwise."""
    groups: dict[str, list[tuple[str, ...]]] = {
        "rotation": [("line_a", "line_b", "index_line")],
        "motion": [("position", "quaternion"), ("position",)],
    }
    for quantities in groups.get(made.kind, ()):
        there = [
            (k, one) for k, one in enumerate(made.columns) if one.role == "reference" and one.quantity in quantities
        ]
        for key in ("delay", "gain_uncertainty") if len(quantities) != 2 else ("delay",):
            for number, one in there[1:]:
                if getattr(one, key) != getattr(there[0][1], key):
                    said = f"found another {key} than that of {there[0][1].channel}, wanted one for the whole reference"
                    yield document.problem(("columns", number), said)


def _of_motion(document: Document, made: Manifest) -> Iterator[Problem]:
    """A track needs every component of position and attitude, and how the attitude is to be read."""
    if made.pose is None:
        yield document.problem((), "found no key 'pose', wanted it to say how the quaternion turns and which way is up")
    for quantity, names in (("quaternion", "wxyz"), ("position", "xyz")):
        columns = made.of("reference", quantity)
        there = [one.component if quantity == "quaternion" else one.axis for one in columns]
        lacking = [name for name in names if name not in there]
        if lacking:
            text = f"found no reference column of {quantity} {', '.join(lacking)}, wanted {', '.join(names)}"
            yield document.problem(("columns",), text)


def _unread_of_column(kind: str, role: str, quantity: str, stated: Set[str]) -> Iterator[tuple[str, str]]:
    """Keys of a column that nothing would read, each with what was wanted."""
    mine = KINDS[kind]
    for key in dict.fromkeys(key for one in KINDS.values() for key in one.columns):
        if key in stated and not any(one.holds(role, quantity) for one in mine.columns.get(key, ())):
            yield key, f"wanted nothing in a {role} column of {quantity} of a {kind}{mine.instead.get(key, '')}"


def _unread_of_file(kind: str, stated: Set[str]) -> Iterator[tuple[str, str]]:
    """The same for keys of the file, such as "mains" or "compared.rate_band"; of what is nested the outer one first."""
    mine = KINDS[kind]
    for key in sorted({key for one in KINDS.values() for key in one.keys}):
        outer = key.partition(".")[0]
        if key in stated and key not in mine.keys and (outer == key or outer in mine.keys):
            yield key, f"wanted nothing for a {kind}{mine.instead.get(key, '')}"
