"""From runs to a calibration: sweeps, turntable runs, tumbles and records at rest of one unit, merged.

Each kind of run contributes what it can determine; what no run determines is in the calibration too, with the run that
would. Runs of different units or benches are refused.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rig.archive.records import Recorded, is_imported
from rig.calibrate import imported, paper_method, resting, tumble_runs
from rig.calibrate.analyzer_route import SecondRoute, second_route
from rig.calibrate.basis import Basis, basis_of
from rig.calibrate.calibration import Calibration, PaperRow, Result, Source
from rig.calibrate.combining import combined
from rig.calibrate.cube_route import Recorder, recorder_of, said
from rig.calibrate.fitted import Assumed, Experiment
from rig.calibrate.fitted import experiments as experiments_fitted
from rig.calibrate.influences import Influences
from rig.calibrate.input_noise import noise_results, scales_of
from rig.calibrate.joined import joined, of_model
from rig.calibrate.judging import believed
from rig.calibrate.merging import together
from rig.calibrate.screening import screened
from rig.calibrate.shaker_runs import ShakerRuns
from rig.calibrate.time_base import clock_of, flagged
from rig.calibrate.turntable_runs import TurntableRuns
from rig.errors import BadInput
from rig.fit.evidence import evidence_of
from rig.parts.reading import by_cube
from rig.parts.reading import runs as reading
from rig.parts.reading.runs import Reader, same_unit
from rig.sensor import Sensor

READERS: Mapping[Recorder, Reader] = {"converter": reading.read, "cube": by_cube.read}
_DATA_SHEET = Assumed()


def calibrate(
    runs: Sequence[Recorded],
    name: str,
    digests: Mapping[str, str] | None = None,
    assumed: Assumed | None = _DATA_SHEET,
    recorder: Recorder | None = None,
) -> Calibration:
    """One calibration from all runs of a unit; `digests` are SHA-256 of the seals by run.

    Values stand on the model `assumed`, fitted to all records of an experiment, with the direct estimates beside them;
    without a model (None) they are the direct estimates. `recorder` is the one to read the sensor from (None: the
    converter, else the oscilloscope, else the cube); no model reads the oscilloscope's records.

    Raises BadInput for runs of different units, a sweep of the wrong axis or without its reference, and for runs that
    determine nothing; StandardOverdue for a standard used past its date without an order.
    """
    foreign, own = [[run for run in runs if is_imported(run) == kind] for kind in (True, False)]
    if foreign and own:
        return _of_both(own, foreign, name, digests, assumed, recorder)
    if foreign:
        return imported.calibration(runs, name, _sources(runs, digests), assumed or _DATA_SHEET)
    return _of_bench(runs, name, digests, assumed, recorder)


def _of_bench(
    runs: Sequence[Recorded],
    name: str,
    digests: Mapping[str, str] | None,
    assumed: Assumed | None,
    recorder: Recorder | None,
) -> Calibration:
    """Of the bench's own runs."""
    header = _common_header(runs)
    sensor = Sensor.of(header)
    chosen = recorder_of(runs, sensor, recorder)
    looked = screened(runs, sensor, chosen)
    basis = basis_of(looked.runs, header, chosen)
    assumed = assumed if basis.recorder in READERS else None
    fits, unfitted = ({}, ()) if assumed is None else _fitted(looked.runs, assumed, basis.recorder)
    shaken = ShakerRuns(basis)
    turned = TurntableRuns(basis)
    influences = Influences(runs, chosen)
    results = _on_model(shaken, turned, assumed, fits)
    second = second_route(basis.runs, sensor, shaken.setup())
    by_analyzer = [] if second is None else list(influences.added(second.results(results)))
    results = list(influences.added([*results, *tumble_runs.results(basis, assumed)]))
    results += _noise(basis, results, shaken, turned)
    clocks = [] if chosen == "cube" else [one for run in runs if (one := clock_of(run)) is not None]
    results = [*flagged(looked.flagged(said(results, basis.recorder)), clocks), *looked.rows(sensor)]
    _refuse_nothing(runs, results)
    results += by_analyzer
    relative = tuple(influences.flags(results))
    return Calibration(
        name=name,
        sensor=sensor.name,
        serial=sensor.serial,
        made=max(entry.t for records in runs for entry in records.lines),
        simulated=any(records.header["simulated"] for records in runs),
        sources=_sources(runs, digests),
        standards=tuple(header["standards"]),
        conditions=resting.conditions_of(runs),
        results=_concluded(results, sensor),
        responses=influences.widened(shaken.responses(), "sweep"),
        analyzer={} if second is None else influences.widened(second.responses(), "analyzer"),
        paper=tuple(_paper(shaken, basis)),
        overdue=tuple(dict.fromkeys(late for records in runs for late in records.header["overdue_overridden"])),
        flags=tuple(dict.fromkeys([*looked.flags(), *unfitted, *_flags(basis, shaken, turned, second), *relative])),
        program={key: str(value) for key, value in header["program"].items()},
        unit=header["sensor"],
        model="" if assumed is None else assumed.said,
    )


def _on_model(
    shaken: ShakerRuns, turned: TurntableRuns, assumed: Assumed | None, fits: Mapping[str, Experiment]
) -> list[Result]:
    """Results of sweeps and turntable runs, on the fitted model if one is assumed."""
    results = [*shaken.results(), *turned.results()]
    if assumed is None:
        return results
    direct = {one.key: one for one in (*shaken.direct(), *turned.direct())}
    results = [joined(r, direct[r.key], fits, assumed) if r.key in direct else r for r in results]
    return [*results, *of_model(fits, assumed)]


def _fitted(
    runs: Sequence[Recorded], assumed: Assumed, recorder: Recorder
) -> tuple[dict[str, Experiment], tuple[str, ...]]:
    """The model fitted to each experiment; nothing, and why, for runs that no model can be compared with."""
    moved = [run for run in runs if any("frequency" in b or "phase" in b for b in run.points.values())]
    if not moved:
        return {}, ()
    try:
        return experiments_fitted(evidence_of(moved, READERS[recorder]), assumed), ()
    except BadInput as error:
        return {}, (f"no model was fitted, values are the direct estimates: {error}",)


def _noise(basis: Basis, results: Sequence[Result], shaken: ShakerRuns, turned: TurntableRuns) -> Iterator[Result]:
    """Noise at rest and in motion, referred to the input by sensitivities among these results where there are some."""
    scales = scales_of(basis.sensor, results)
    yield from noise_results(basis.sensor, basis.noise, basis.without_noise, scales)
    yield from turned.noise_in_motion(scales)
    yield from shaken.noise_in_motion(scales)


def _refuse_nothing(runs: Sequence[Recorded], results: Iterable[Result]) -> None:
    if not any(r.determined or r.rejected for r in results):
        raise BadInput(f"{', '.join(r.name for r in runs)}: found nothing that determines a value, wanted a sweep, "
                       "a turntable run, a tumble or a noise record")  # fmt: skip


def _flags(basis: Basis, shaken: ShakerRuns, turned: TurntableRuns, second: SecondRoute | None) -> Iterator[str]:
    yield from basis.flags()
    yield from shaken.flags()
    yield from turned.flags()
    if second is not None:
        yield from second.flags()


def _paper(shaken: ShakerRuns, basis: Basis) -> Iterator[PaperRow]:
    """The published estimators, which read the converter."""
    if basis.recorder == "cube":
        return
    yield from paper_method.accelerometer_rows(shaken.everything(), basis.sensor, basis.runs)
    for one in basis.runs:
        yield from paper_method.gyro_rows(one, basis.sensor)


def _of_both(
    own: Sequence[Recorded],
    foreign: Sequence[Recorded],
    name: str,
    digests: Mapping[str, str] | None,
    assumed: Assumed | None,
    recorder: Recorder | None,
) -> Calibration:
    """Of the bench's own runs and of imported ones in volts; BadInput for imported ones in another unit."""
    if not same_unit(foreign[0], own[0]):
        raise BadInput(f"{foreign[0].name}: found another unit than in {own[0].name}, wanted runs of one unit")
    theirs = imported.calibration(foreign, name, _sources(foreign, digests), assumed or _DATA_SHEET, volts=True)
    made = together(_of_bench(own, name, digests, assumed, recorder), theirs)
    sensor = made.under_test
    return replace(made, results=_concluded(made.results, sensor))


def _concluded(results: Iterable[Result], sensor: Sensor) -> tuple[Result, ...]:
    """In their order, judged, with one value of every sensitivity that several references give."""
    return tuple(combined(list(believed(_ordered(results, sensor), sensor)), sensor))


def _common_header(runs: Sequence[Recorded]) -> Mapping[str, Any]:
    if not runs:
        raise BadInput("calibrate: found no run, wanted at least one")
    first = runs[0].header
    for records in runs[1:]:
        for key in ("sensor", "standards", "simulated"):
            if records.header[key] != first[key]:
                raise BadInput(f"{records.name}: found another {key} than in {runs[0].name}, wanted runs of one unit "
                               "on one bench")  # fmt: skip
    return first


def _sources(runs: Sequence[Recorded], digests: Mapping[str, str] | None) -> tuple[Source, ...]:
    return tuple(
        Source(
            records.name, str(records.header.get("procedure") or records.header["title"]), records.status,
            (digests or {}).get(records.name, ""), float(records.header["started"]),
        )
        for records in runs
    )  # fmt: skip


def _ordered(results: Iterable[Result], sensor: Sensor) -> list[Result]:
    """By channel as in the sensor file; of a measurand determined twice (offset: sweep and tumble) the better one."""
    best: dict[str, Result] = {}
    for result in results:
        before = best.get(result.key)
        if before is None or (result.determined and (not before.determined or result.u < before.u)):
            best[result.key] = result
    places = {name: place for place, name in enumerate(sensor.names)}
    return sorted(best.values(), key=lambda r: places.get(r.channel, len(places)))


def digest_of(seal: bytes) -> str:
    """SHA-256 of a seal's bytes."""
    return hashlib.sha256(seal).hexdigest()
