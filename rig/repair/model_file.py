"""A model of a unit as a file: its effects with values and uncertainties, and the history of how it came to be.

    format: 1
    unit: SIM-CUBE-1
    start: datasheet                # or paper: without output filters; or shared: one sensitivity for all axes
    simulated: true
    runs: [2026-11-02T080000-sweep-x]
    effects:
    - effect: cubic
      on: acceleration              # left out where the effect can act on one kind of channel only
      coordinates: {coefficient: {value: 1.2e-05, u: 3.0e-07}}
      parameters: {coefficient: {value: 1.2e-05, unit: 1/(m/s²)², u: 3.0e-07}}
    - effect: delay
      on: acceleration
      channels: [unit_a_x]          # left out where all of the kind have it
      coordinates: {time: {value: 1.0e-03, u: 1.0e-05}}
    - effect: drag                  # a term of one's own; its name is free
      formula: k * omega**2
      on: rate
      channels: [gyro_yaw]          # left out where all of the kind feel it
      values: {k: 0.001}            # where a fit begins, SI
    covariance: {order: [cubic (acceleration).coefficient], values: [[9.0e-14]]}
    channels: …                     # axis, sensitivity, pole and zero outputs as fitted
    history: …                      # every step with its error on fitted and on held-out data, noise = 1

Everything is SI. Coordinates are what is fitted; parameters are the same in the terms that a person reads, so in a file
written by hand either will do. Uncertainties are standard ones. The file is written whole or not at all, always in the
same order, so that two versions can be compared line by line.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from rig.errors import BadInput, ConfigError, Problem
from rig.model import BOTH, EVERYWHERE, Effect, Experiment, Quantity, Term
from rig.yaml import config
from rig.yaml.document import Document, KeyPath

if TYPE_CHECKING:
    from rig.fit.evidence import Evidence
    from rig.fit.fit import Fit
    from rig.fit.parameters import Estimate
    from rig.fit.quality import Errors, Place

Start = Literal["datasheet", "paper", "shared"]
Action = Literal["start", "add", "remove", "fit"]
FORMAT: Literal[1] = 1
OUTPUT_FILTER = "output_filter"  # an entry that gives every channel of the paper's model its output filter
OWN_SENSITIVITY = "own_sensitivity"  # an entry that gives every channel of the shared model a sensitivity of its own
OF_CHANNELS = (OUTPUT_FILTER, OWN_SENSITIVITY)  # no effects of the shelf but parts of every channel
DIGITS = 10  # of a value: more is noise that would show as a difference
NO_STARTS: Mapping[str, tuple[float, ...]] = MappingProxyType({})
AGREE = 1e-6  # relative: parameters and coordinates that say the same


class Strict(BaseModel):
    """A part of the file that refuses what it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Coordinate(Strict):
    """A fitted number, SI; `u` is left out for one that a fit does not move."""

    value: float
    u: float | None = Field(default=None, ge=0)


class Value(Strict):
    """A number with its unit (SI) and standard uncertainty, which is left out where it is not known."""

    value: float
    unit: str = ""
    u: float | None = Field(default=None, ge=0)


class Entry(Strict):
    """One effect of the shelf, or a term by formula.

    `channels` of the kind that alone have it. Of a formula: `values` are starts of its coefficients, SI.
    """

    effect: str
    formula: str | None = None
    on: Quantity | None = None
    places: tuple[Experiment, ...] | None = None
    channels: tuple[str, ...] = ()
    units: dict[str, str] = Field(default_factory=dict)
    values: dict[str, float] = Field(default_factory=dict)
    coordinates: dict[str, Coordinate] = Field(default_factory=dict)
    parameters: dict[str, Value] = Field(default_factory=dict)

    @property
    def where(self) -> str:
        """The channels that have it in words; "" where the effect says it."""
        return ", ".join(self.channels) or self.on or ""

    def is_of(self, name: str, on: Quantity | None, channels: Sequence[str] = ()) -> bool:
        """Whether it is this effect, on these channels if they are named."""
        return self.effect == name and on in (None, self.on) and (not channels or set(channels) == set(self.channels))


class Covariance(Strict):
    """Covariance of the fitted coordinates of all effects, SI; `order` names rows and columns."""

    order: tuple[str, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()


class ChannelEntry(Strict):
    """One channel as fitted: `pole` of the output filter (none in the paper's model), `zero` output V by record set.

    `u_zero` V, left out for a record set that does not determine it; `axis` of the case; `triad` names the channels
    that stand together; `slot` of the scan, counted from the reference's.
    """

    sensitivity: Value
    pole: Value | None = None
    zero: dict[str, float] = Field(default_factory=dict)
    u_zero: dict[str, float] = Field(default_factory=dict)
    axis: Literal["x", "y", "z"] | None = None
    triad: str = ""
    slot: int | None = None


class Step(Strict):
    """One step of the history.

    `error` is √(χ²/n) of all rows against their noise; `heldout` that of rows which a fit without them predicts (left
    out where too few are held out); `worst` that at `worst_at`, the channel and domain where it stands out most,
    `worst_heldout` of the rows held out there, and `worst_error` the same in `worst_unit`, SI.
    `chi2_dof`: χ² per degree of freedom, priors included. `when`: bench time of the newest record, s since 1970 UTC.
    """

    action: Action
    effect: str | None = None
    on: Quantity | None = None
    channels: tuple[str, ...] | None = None
    runs: tuple[str, ...]
    chi2_dof: float
    error: float
    heldout: float | None = None
    noise: float = 1.0
    worst: float | None = None
    worst_at: str = ""
    worst_heldout: float | None = None
    worst_error: float | None = None
    worst_unit: str = ""
    when: float

    @property
    def where(self) -> str:
        """On which channels, where that was said."""
        return ", ".join(self.channels or ()) or self.on or ""

    @property
    def place(self) -> Place:
        """Where the error was largest."""
        from rig.fit.quality import Place

        values = [math.nan if one is None else one for one in (self.worst, self.worst_heldout, self.worst_error)]
        return Place(self.worst_at, values[0], values[1], values[2], self.worst_unit)


class Model(Strict):
    """A model as it stands in its file."""

    format: Literal[1] = FORMAT
    unit: str
    start: Start = "datasheet"
    simulated: bool = False
    runs: tuple[str, ...] = ()
    effects: tuple[Entry, ...] = ()
    covariance: Covariance = Covariance()
    channels: dict[str, ChannelEntry] = Field(default_factory=dict)
    history: tuple[Step, ...] = ()

    @property
    def poles(self) -> bool:
        """Whether channels have the output filter: from the start, or added to the paper's model."""
        return self.start != "paper" or any(entry.effect == OUTPUT_FILTER for entry in self.effects)

    @property
    def shared(self) -> bool:
        """Whether all channels of a quantity have one sensitivity."""
        return self.start == "shared" and not any(entry.effect == OWN_SENSITIVITY for entry in self.effects)


def path_of(runs: Path, serial: str) -> Path:
    """Where the model of a unit is kept under the runs folder."""
    plain = "".join(c if c.isalnum() or c in "-_." else "-" for c in serial).lstrip(".")
    return runs / "models" / f"{plain or 'unit'}.yaml"


def load(path: Path, shelf: Mapping[str, Effect] | None = None) -> Model:
    """Read a model. Raises ConfigError that names every mistake by file, line, column and key.

    With a shelf, effects and their coordinates are checked against it too.
    """
    if not path.exists():
        raise BadInput(f"{path}: found no model, wanted a file made by `rig fit last`")
    document = config.read(path)
    model = config.validate(document, Model)
    problems = sorted(_mistakes(document, model, shelf))
    if problems:
        raise ConfigError(problems)
    return model


def save(path: Path, model: Model) -> None:
    """Write a model; the file appears whole or not at all. Raises ArchiveError if it cannot be kept."""
    from rig.archive.durable import keeping, write_whole

    with keeping(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, as_text(model).encode())


def as_text(model: Model) -> str:
    """The file's text."""
    import yaml

    body = model.model_dump(mode="json", exclude_none=True)
    body["effects"] = [{key: part for key, part in entry.items() if part not in ({}, [])} for entry in body["effects"]]
    return str(
        yaml.dump(body, Dumper=_writer(), allow_unicode=True, sort_keys=False, width=10_000, default_flow_style=None)
    )


def _writer() -> type[Any]:
    """PyYAML's writer with the words of YAML 1.2, in which `on` is text."""
    import re

    import yaml

    class Writer(yaml.SafeDumper):
        yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's own name
            first: [one for one in found if one[0] != "tag:yaml.org,2002:bool"]
            for first, found in yaml.SafeDumper.yaml_implicit_resolvers.items()
        }

        def ignore_aliases(self, data: Any) -> bool:
            return True

    Writer.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile("^(?:true|false)$"), list("tf"))
    return Writer


def terms_of(model: Model, shelf: Mapping[str, Effect]) -> list[Term]:
    """The effects at their coordinates, in order. Raises BadInput for one that the shelf does not have."""
    return [_term(entry, shelf) for entry in model.effects if entry.effect not in OF_CHANNELS]


def _term(entry: Entry, shelf: Mapping[str, Effect]) -> Term:
    effect = effect_of(entry, shelf)
    on = entry.on or (effect.quantities[0] if len(effect.quantities) == 1 else None)
    at = {c.name: c.starts[0] for c in effect.coordinates}
    if entry.coordinates:
        at |= {name: one.value for name, one in entry.coordinates.items()}
    elif entry.parameters:
        at |= effect.from_physical({name: one.value for name, one in entry.parameters.items()})
    else:
        at |= entry.values
    return Term(effect, on, at, only=entry.channels if entry.formula is None else ())


def effect_of(
    entry: Entry, shelf: Mapping[str, Effect], starts: Mapping[str, tuple[float, ...]] = NO_STARTS
) -> Effect:  # fmt: skip
    """The effect of the shelf, or the one that the formula makes. Raises BadInput if it is neither.

    `starts` of a formula's coefficients, SI, go before the entry's own, which are one for each.
    """
    if entry.formula is not None:
        from rig.formula import formula_effect

        if entry.effect in shelf or entry.effect in OF_CHANNELS:
            raise BadInput(
                f"found the name '{entry.effect}' for a formula, which an effect of the shelf has, "
                "wanted a name of its own (or the effect, without a formula)"
            )
        own = {name: (value,) for name, value in entry.values.items()}
        places = tuple(entry.places) if entry.places else EVERYWHERE
        return formula_effect(
            entry.effect, entry.formula, on=entry.on or "acceleration", places=places, units=entry.units,
            starts={**own, **starts}, channels=entry.channels,
        )  # fmt: skip
    if entry.effect not in shelf:
        raise BadInput(f"found '{entry.effect}', wanted {_near(entry.effect, shelf)}")
    return shelf[entry.effect]


def _near(name: str, shelf: Mapping[str, Effect]) -> str:
    import difflib

    near = difflib.get_close_matches(name, shelf, 3) or sorted(shelf)[:3]
    return f"an effect of the shelf such as {', '.join(near)}"


# what the types cannot say
def _mistakes(document: Document, model: Model, shelf: Mapping[str, Effect] | None) -> Iterator[Problem]:
    size = len(model.covariance.order)
    if len(model.covariance.values) != size or any(len(row) != size for row in model.covariance.values):
        yield document.problem(("covariance", "values"), f"found another shape, wanted {size} rows of {size} numbers")
    for number, entry in enumerate(model.effects):
        at: KeyPath = ("effects", number)
        if entry.effect in OF_CHANNELS and entry.formula is None:
            continue
        if entry.formula is not None and entry.on is None:
            yield document.problem((*at, "on"), "found nothing, wanted acceleration or rate")
        elif shelf is not None:
            yield from _mistakes_of(document, at, entry, shelf)


def _mistakes_of(document: Document, at: KeyPath, entry: Entry, shelf: Mapping[str, Effect]) -> Iterator[Problem]:
    key = "formula" if entry.formula is not None else "effect"
    try:
        effect = effect_of(entry, shelf)
    except BadInput as error:
        yield document.problem((*at, key), str(error))
        return
    if entry.formula is None and (said := _wrong_on(entry, effect)):
        yield document.problem((*at, "on"), said)
    known = {"coordinates": [c.name for c in effect.coordinates], "parameters": [p.name for p in effect.parameters]}
    for part, names in known.items():
        given = getattr(entry, part)
        for name in given:
            if name not in names:
                yield document.problem((*at, part, name), f"found an unknown name, wanted one of {', '.join(names)}")
        stray = any(name not in names for name in given)
        missing = [name for name in names if given and not stray and name not in given]
        if stray:
            return
        if missing:
            yield document.problem((*at, part), f"found no {missing[0]}, wanted {', '.join(names)}")
            return
    yield from _contradictions(document, at, entry, effect)


def _wrong_on(entry: Entry, effect: Effect) -> str:
    if entry.on is None and len(effect.quantities) > 1:
        return f"found nothing, wanted {' or '.join(BOTH)}"
    if entry.channels and not effect.quantities:
        return f"found channels {', '.join(entry.channels)}, wanted no such key: it acts on everything alike"
    if entry.on is not None and entry.on not in effect.quantities:
        wanted = " or ".join(effect.quantities) or "no such key: it acts on everything alike"
        return f"found '{entry.on}', wanted {wanted}"
    return ""


def _contradictions(document: Document, at: KeyPath, entry: Entry, effect: Effect) -> Iterator[Problem]:
    """Parameters that were changed by hand beside coordinates that were not."""
    if not entry.coordinates or not entry.parameters:
        return
    if set(entry.coordinates) != {c.name for c in effect.coordinates}:
        return
    wanted = effect.physical({name: one.value for name, one in entry.coordinates.items()})
    for name, one in entry.parameters.items():
        if name in wanted and not math.isclose(one.value, wanted[name], rel_tol=AGREE, abs_tol=1e-15):
            text = f"found {one.value:g}, wanted {wanted[name]:g} as the coordinates say, or no coordinates"
            yield document.problem((*at, "parameters", name, "value"), text)


# from a fit
def with_fit(
    model: Model, evidence: Evidence, fit: Fit, *, action: Action, when: float, effect: str | None = None,
    on: Quantity | None = None, channels: Sequence[str] = (),
    known: Mapping[str, Mapping[str, float]] | None = None, errors: Errors | None = None,
) -> Model:  # fmt: skip
    """The model with the values of a fit, and one more step of history.

    `when` is the newest bench time of the runs, s; `errors` of the fit, where they are known already. Formulas of the
    model's entries are kept. `known` gives standard uncertainties of coordinates by effect, for effects that a test of
    their own determined and no fit moves.
    """
    from rig.fit.quality import chi2_dof, errors_of

    formulas = {entry.effect: entry for entry in model.effects if entry.formula is not None}
    known = known or {}
    filters = [entry for entry in model.effects if entry.effect in OF_CHANNELS]
    numbers = [n for n, term in enumerate(fit.state.terms) if not term.prior]
    errors = errors or errors_of(evidence, fit)
    worst = errors.worst
    step = Step(
        action=action, effect=effect, on=on, channels=tuple(channels) or None, runs=evidence.runs,
        chi2_dof=_short(chi2_dof(fit)), error=_short(errors.error), heldout=_finite(errors.heldout),
        worst=_finite(worst.ratio), worst_at=worst.where, worst_heldout=_finite(worst.heldout),
        worst_error=_finite(worst.error), worst_unit=worst.unit, when=round(when, 3),
    )  # fmt: skip
    return model.model_copy(
        update={
            "unit": evidence.serial,
            "simulated": evidence.simulated,
            "runs": evidence.runs,
            "effects": (*filters, *(_entry(fit, n, formulas, known) for n in numbers)),
            "covariance": _covariance(fit, numbers, known),
            "channels": _channels(fit),
            "history": (*model.history, step),
        }
    )


def _short(value: float, digits: int = 6) -> float:
    """As many digits as mean something, so that two versions of a file differ where the model does."""
    return float(f"{value:.{digits}g}")


def _finite(value: float) -> float | None:
    return _short(value) if math.isfinite(value) else None


def _entry(fit: Fit, number: int, formulas: Mapping[str, Entry], known: Mapping[str, Mapping[str, float]]) -> Entry:
    from rig.fit.parameters import covariance_of, estimates, independent

    term = fit.state.terms[number]
    u = {**fit.u(number), **known.get(term.effect.name, {})}
    before = formulas.get(term.effect.name)
    mine = known.get(term.effect.name)
    covariance = covariance_of(fit, number) if mine is None else independent(term, mine)
    return Entry(
        effect=term.effect.name,
        formula=before.formula if before else None,
        places=before.places if before else None,
        channels=before.channels if before else term.only,
        units=before.units if before else {},
        values=before.values if before else {},
        on=term.on if len(term.effect.quantities) > 1 or before else None,
        coordinates={
            c.name: Coordinate(value=_short(term.at[c.name], DIGITS), u=_short(u[c.name]) if c.name in u else None)
            for c in term.effect.coordinates
        },
        parameters=_parameters(estimates(term, covariance)),
    )


def _parameters(found: Mapping[str, Estimate]) -> dict[str, Value]:
    """Parameters for the file; none of them where one is not finite, as a corner is without a filter."""
    if not all(math.isfinite(one.value) for one in found.values()):
        return {}
    return {
        name: Value(value=_short(one.value, DIGITS), unit=one.unit, u=None if one.u is None else _short(one.u))
        for name, one in found.items()
    }


def _covariance(fit: Fit, numbers: Sequence[int], known: Mapping[str, Mapping[str, float]]) -> Covariance:
    from rig.fit.fit import fitted

    order: list[str] = []
    rows: list[int] = []
    alone: list[float | None] = []  # variances that a test of its own gave
    for n in numbers:
        term, mine = fit.state.terms[n], known.get(fit.state.terms[n].effect.name)
        for k, name in enumerate(fitted(term)):
            order.append(f"{term.key}.{name}")
            rows.append(fit.layout.terms[n] + k)
            alone.append(None if mine is None else mine.get(name, 0.0) ** 2)
    values = fit.covariance[np.ix_(rows, rows)]
    for k, variance in enumerate(alone):
        if variance is not None:
            values[k, :], values[:, k] = 0.0, 0.0
            values[k, k] = variance
    return Covariance(order=tuple(order), values=tuple(tuple(_short(v) for v in row) for row in values.tolist()))


def _channels(fit: Fit) -> dict[str, ChannelEntry]:
    found: dict[str, ChannelEntry] = {}
    for number, part in enumerate(fit.parts):
        for c, name in enumerate(part.channels.names):
            found[name] = _channel(fit, number, c, found.get(name))
    return found


def _channel(fit: Fit, number: int, c: int, before: ChannelEntry | None) -> ChannelEntry:
    """A channel after one more of the parts that it is in; zeros are every part's own."""
    part = fit.parts[number]
    channels, local = part.channels, fit.state.local(part, number)
    u_gain, u_log_pole, u_zero = np.sqrt(np.maximum(np.diag(fit.covariance)[fit.layout.own(part, number)[c]], 0.0))
    pole, unit = float(local.pole[c]), "V/(rad/s)" if channels.rates[c] else "V/(m/s²)"
    sensitivity = Value(
        value=_short(float(local.sensitivity[c]), DIGITS), unit=unit,
        u=_short(abs(float(channels.sensitivity[c])) * float(u_gain)),
    )  # fmt: skip
    filtered = Value(value=_short(pole, DIGITS), unit="Hz", u=_short(pole * float(u_log_pole)))
    determined = {part.name: _short(float(u_zero))} if u_zero > 0.0 else {}
    return ChannelEntry(
        sensitivity=sensitivity,
        pole=filtered if fit.state.poles and math.isfinite(pole) else None,
        zero={
            **(before.zero if before else {}),
            **({part.name: _short(float(local.zero[c]), DIGITS)} if part.calibrates else {}),
        },
        u_zero={**(before.u_zero if before else {}), **determined},
        axis="xyz"[channels.axis[c]],
        triad=channels.unit[c],
        slot=before.slot if before else int(channels.slot[c]),
    )
