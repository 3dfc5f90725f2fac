"""Figures of a misfit: the right files, readable, with the words and the mark that they must carry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import fast_bench
import numpy as np
import pytest
from matplotlib.axes import Axes

from rig.diagnose.misfit import conditions
from rig.diagnose.misfit_cells import tables
from rig.fit.evidence import Evidence, evidence_of
from rig.motion import Array
from rig.report.misfit_figures import draw
from rig.report.noise_figure import noises
from rig.report.platter_figure import turntable
from rig.report.sweep_figure import shaker


def _drawn(axes: Axes, *, points: int) -> list[tuple[Array, Array]]:
    """x and y of every line with at least so many points."""
    pairs = [(np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)) for line in axes.get_lines()]
    return [(x, y) for x, y in pairs if len(x) >= points]


@pytest.fixture(scope="module")
def sweep() -> Evidence:
    hidden = [{"name": "quadratic", "parameters": {"coefficient": 8e-4, "quantity": "acceleration"}}]
    return evidence_of([fast_bench.measure({"procedure": "frequency_sweep", "axis": "x"}, fast_bench.world(1, hidden))])


@pytest.fixture(scope="module")
def turn() -> Evidence:
    hidden = [{"name": "encoder_eccentricity", "parameters": {"ratio": 8e-3, "direction": 1.0}}]
    return evidence_of([fast_bench.measure({"procedure": "turntable"}, fast_bench.world(1, hidden))])


def test_a_sweep_has_one_figure_in_svg_and_png(sweep: Evidence, tmp_path: Path) -> None:
    paths = draw(sweep, sweep.fitted(), tmp_path / "figures", ("svg", "png"))
    assert [path.name for path in paths] == ["misfit_shaker.svg", "misfit_shaker.png"]
    assert paths[0].read_text(encoding="utf-8").startswith("<?xml")
    assert paths[1].read_bytes().startswith(b"\x89PNG")


def test_only_a_simulated_figure_says_so(sweep: Evidence, tmp_path: Path) -> None:
    fit = sweep.fitted()
    marked = draw(sweep, fit, tmp_path / "a")[0].read_text(encoding="utf-8")
    plain = draw(replace(sweep, simulated=False), fit, tmp_path / "b")[0].read_text(encoding="utf-8")
    assert "<!-- SIMULATED -->" in marked
    assert "SIMULATED" not in plain


def test_the_same_fit_gives_the_same_file(sweep: Evidence, tmp_path: Path) -> None:
    fit = sweep.fitted()
    assert draw(sweep, fit, tmp_path / "a")[0].read_bytes() == draw(sweep, fit, tmp_path / "b")[0].read_bytes()


def test_the_title_says_the_worst_condition_and_the_last_row_shows_it(sweep: Evidence) -> None:
    fit = sweep.fitted()
    figure = shaker(fit, 0, sweep.parts[0], conditions(fit, tables(fit)))
    assert "2f" in figure.get_suptitle()
    assert "as the square of the level" in figure.get_suptitle()
    last = figure.axes[4]
    assert last.get_ylabel() == "size of 2f ÷ noise"
    assert max(float(np.nanmax(y)) for _, y in _drawn(last, points=20)) > 5.0


def test_a_turntable_run_shows_its_misfit_at_the_first_order(turn: Evidence) -> None:
    fit = turn.fitted()
    figure = turntable(fit, 0, turn.parts[0], conditions(fit, tables(fit)))
    time, angle, orders = figure.axes
    assert "once per revolution" in figure.get_suptitle()
    assert max(float(np.max(np.abs(y))) for _, y in _drawn(angle, points=36)) > 4.0
    x, y = max(_drawn(orders, points=5), key=lambda one: float(np.max(one[1])))
    assert x[int(np.argmax(y))] == pytest.approx(1.0, abs=0.15)
    legend = time.get_legend()
    assert legend is not None
    assert "gyro_yaw" in " ".join(text.get_text() for text in legend.get_texts())


def test_a_clean_world_says_that_nothing_stands_out_and_stays_in_the_band(tmp_path: Path) -> None:
    run = fast_bench.measure({"procedure": "frequency_sweep", "axis": "x", "points": 12}, fast_bench.world(7))
    clean = evidence_of([run])
    fit = clean.fitted()
    figure = shaker(fit, 0, clean.parts[0], conditions(fit, tables(fit)))
    assert "nothing stands out of the noise" in figure.get_suptitle()
    values = np.concatenate([y for _, y in _drawn(figure.axes[0], points=3)])
    assert np.mean(np.abs(values) < 2.0) > 0.85


def test_noise_that_a_model_lacks_is_drawn_with_what_the_data_sheet_says(tmp_path: Path) -> None:
    hidden = [{"name": "white", "parameters": {"density": 4e-4, "quantity": "acceleration"}}]
    world = fast_bench.world(3, hidden)
    loud = evidence_of([fast_bench.measure({"procedure": "frequency_sweep", "axis": "x"}, world)])
    fit = loud.fitted()
    assert [path.name for path in draw(loud, fit, tmp_path)] == ["misfit_shaker.svg", "misfit_noise.svg"]
    numbers = [n for n, part in enumerate(fit.parts) if part.drawing == "noise"]
    ((_, figure),) = noises(fit, numbers, conditions(fit, tables(fit)))
    density, deviation = figure.axes[:2]
    seen, _, model, sheet = [np.asarray(line.get_ydata(), float) for line in density.get_lines()][-4:]
    high = len(model) // 4  # where flicker has no part in it, at least as much white noise is hidden as is stated
    assert np.all(model[-high:] > 1.2 * sheet[-high:])
    assert np.median(seen[-high // 2 :] / model[-high // 2 :]) == pytest.approx(1.0, abs=0.1)
    assert max(np.abs(line.get_ydata()).max() for line in deviation.get_lines() if len(line.get_xdata()) > 5) > 4.0
    assert "white" in figure.get_suptitle()
    assert "times the noise" not in figure.get_suptitle().replace("\u00a0", " ")
