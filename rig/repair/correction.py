"""From a model's file to the correction that a robot needs: channels as fitted, effects each with its inverse."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

from rig.correction.chain import Channel, Undone
from rig.correction.correction import Correction
from rig.correction.inverse import AXES
from rig.errors import BadInput
from rig.model import Effect
from rig.repair.model_file import ChannelEntry, Model, load, terms_of

RATE_UNIT = "V/(rad/s)"


def correction_at(path: Path, shelf: Mapping[str, Effect]) -> Correction:
    """The correction of a model's file. Raises BadInput if it holds no fit, ConfigError for mistakes."""
    model = load(path, shelf)
    if not model.channels:
        raise BadInput(f"{path}: found no channels, wanted a model that was fitted (`rig fit RUN…`)")
    return correction_of(model, shelf)


def correction_of(model: Model, shelf: Mapping[str, Effect]) -> Correction:
    """A fitted model turned round."""
    return Correction(
        unit=model.unit,
        channels=tuple(_channel(name, entry) for name, entry in model.channels.items()),
        undone=tuple(
            Undone(term.key, term.on, term.effect.inverse(term.at), term.only) for term in terms_of(model, shelf)
        ),
        simulated=model.simulated,
        provenance=tuple(_provenance(model)),
    )


def _channel(name: str, entry: ChannelEntry) -> Channel:
    zero, u_zero = zero_of(entry)
    return Channel(
        name=name,
        quantity="rate" if entry.sensitivity.unit == RATE_UNIT else "acceleration",
        axis=AXES.index(entry.axis) if entry.axis else None,
        triad=entry.triad,
        sensitivity=entry.sensitivity.value,
        zero=zero,
        pole=entry.pole.value if entry.pole else None,
        slot=entry.slot,
        u_sensitivity=entry.sensitivity.u or None,
        u_zero=u_zero,
    )


def zero_of(entry: ChannelEntry) -> tuple[float, float | None]:
    """One zero output, V, of those that the record sets gave, weighted by what each of them knows, and its standard
    uncertainty: that of the mean or, where they scatter more, of their scatter. Without uncertainties the last one.
    """
    known = [(entry.zero[name], u) for name, u in entry.u_zero.items() if name in entry.zero and u > 0.0]
    if not known:
        return next(reversed(entry.zero.values()), 0.0), None
    weight = [u**-2.0 for _, u in known]
    mean = sum(w * zero for w, (zero, _) in zip(weight, known, strict=True)) / sum(weight)
    chi2 = sum(((zero - mean) / u) ** 2 for zero, u in known)
    wider = math.sqrt(max(1.0, chi2 / max(len(known) - 1, 1)))
    return mean, wider / math.sqrt(sum(weight))


def _provenance(model: Model) -> Iterator[str]:
    yield f"Model of {model.unit}, {model.start} model with {', '.join(_words(model)) or 'no effect'}."
    if model.runs:
        yield f"Fitted to {', '.join(model.runs)}."
    if model.history:
        last = model.history[-1]
        when = datetime.fromtimestamp(last.when, UTC).isoformat(timespec="seconds")
        held = "" if last.heldout is None else f", on held-out data {last.heldout:.4g}"
        yield f"Records up to {when}; error {last.error:.4g} times the noise{held}."


def _words(model: Model) -> Iterator[str]:
    for entry in model.effects:
        values = ", ".join(f"{name} = {one.value:.6g} {one.unit}".rstrip() for name, one in entry.parameters.items())
        yield f"{entry.effect}{f' on {entry.where}' if entry.where else ''}{f' ({values})' if values else ''}"
