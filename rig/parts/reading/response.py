"""From imported data of kind "response" to tables of frequency responses."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.foreign.faults import faults
from rig.foreign.manifest import Column
from rig.foreign.tables import Foreign, Table
from rig.model import Channels
from rig.motion import Array, Complexes
from rig.parts.response import ResponseRecords, places_of

HELD_OUT = 3  # every third frequency is held out where no file is


def responses(foreign: Foreign) -> list[ResponseRecords]:
    """Every file of a run of kind "response". Raises BadInput for rows that are no numbers."""
    held = any(table.held_out for table in foreign.tables)
    return [_table(foreign, number, table, held) for number, table in enumerate(foreign.tables)]


def _table(foreign: Foreign, number: int, table: Table, by_file: bool) -> ResponseRecords:
    made = foreign.manifest
    frequency = foreign.si(table, made.of("reference", "frequency")[0])
    device: dict[str, Column] = {one.quantity: one for one in made.of("device")}
    ratio, u_magnitude, u_phase, first = _ratio(foreign, table, device)
    excitation = [foreign.si(table, one) for one in made.of("reference", "excitation")]
    along = excitation[0] if excitation else np.ones(len(frequency))
    if not np.isfinite(frequency * np.abs(ratio) * along).all():
        raise BadInput(f"{foreign.run} {table.label}: found rows that are no numbers, wanted a response in every row")
    for what, values in (("frequency", frequency), ("excitation", along), ("magnitude", np.abs(ratio))):
        if not (values > 0.0).all():
            row = int(np.argmin(values > 0.0))
            where = f"{foreign.run} {table.label}, row {row + 1}, {what}"
            raise BadInput(f"{where}: found {values[row]:g}, wanted more than nought")
    if not np.isfinite(u_magnitude + u_phase).all():
        raise BadInput(f"{foreign.run} {table.label}: found uncertainties that are no numbers, wanted one in every row")
    order = np.argsort(frequency, kind="stable")
    order = order[~np.isin(order, _left_out(foreign, table))]
    place = places_of(frequency[order])
    repeat = np.concatenate([np.arange(n) for n in np.bincount(place)])
    held = np.full(len(order), table.held_out) if by_file else place % HELD_OUT == HELD_OUT - 1
    notes: tuple[str, ...] = (
        () if excitation else ("no excitation is stated: what depends on the level cannot be seen",)
    )
    sign = 1.0 if ratio[order[0]].real >= 0.0 else -1.0  # a quarter of a turn is more than any sensor lags so low
    if sign < 0.0:
        notes = (
            *notes,
            f"{table.label}: the response counts against the reference (phase near π at the lowest "
            f"frequency): a matter of sign or mounting, taken as a sensitivity of −1 and not as dynamics",
        )
    return ResponseRecords(
        name=f"{foreign.run}#{number}", run=foreign.run, channels=_channels(first, sign), frequency=frequency[order],
        excitation=along[order], ratio=ratio[order], u_magnitude=u_magnitude[order], u_phase=u_phase[order],
        repeat=repeat, row=order, held=held, gravity=made.gravity.value, notes=notes,
    )  # fmt: skip


def _left_out(foreign: Foreign, table: Table) -> NDArray[np.intp]:
    """Rows that are no measurement."""
    found = [one.rows for column in foreign.manifest.of("device") for one in faults(foreign, table, column)]
    return np.concatenate([np.zeros(0, np.intp), *found])


def _ratio(foreign: Foreign, table: Table, device: Mapping[str, Column]) -> tuple[Complexes, Array, Array, Column]:
    """Complex ratio and the stated uncertainties of magnitude and phase, and the column that names the channel."""
    if "magnitude" in device:
        size, turn = (foreign.si(table, device[name]) for name in ("magnitude", "phase"))
        us = [foreign.u(table, device[name]) for name in ("magnitude", "phase")]
        u_size, u_turn = (np.zeros(len(size)) if u is None else u for u in us)
        return np.asarray(size * np.exp(1j * turn)), u_size, u_turn, device["magnitude"]
    real, imaginary = (foreign.si(table, device[name]) for name in ("real", "imaginary"))
    us = [foreign.u(table, device[name]) for name in ("real", "imaginary")]
    stated = [u for u in us if u is not None] or [np.zeros(len(real))]
    either = np.sqrt(np.mean(np.square(stated), axis=0))
    ratio = real + 1j * imaginary
    with np.errstate(divide="ignore", invalid="ignore"):  # a ratio of nought is refused by its row
        return np.asarray(ratio), either, either / np.abs(ratio), device["real"]


def _channels(column: Column, sign: float) -> Channels:
    """One accelerometer along the drive."""
    return Channels(
        names=(column.channel,), rates=np.zeros(1, np.bool_), axis=np.array(["xyz".index(column.axis or "x")]),
        slot=np.zeros(1, np.intp), side=np.array([math.nan]), sensitivity=np.array([sign]),
        tolerance=np.array([column.tolerance]), pole=np.array([column.bandwidth or math.inf]), unit=("unit",),
    )  # fmt: skip
