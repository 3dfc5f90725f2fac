"""Figures of imported data: what was put into a table, a motion or a pose can be read off them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import foreign_data
import imported_sweeps
import numpy as np
import pytest
from imported_worlds import Unit, rotation
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from rig.diagnose.misfit import compare
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.foreign.finding import Finding
from rig.foreign.manifest_file import load
from rig.foreign.tables import Foreign, Table
from rig.model import Channels, Term
from rig.parts.part import Part
from rig.parts.pose_records import PoseRecords
from rig.parts.poses import Poses
from rig.parts.reading.imported import parts_of
from rig.parts.response import ResponseTable
from rig.parts.track import TrackedMotion
from rig.report.imported_figures import NOISE, following, poses, response
from rig.report.misfit_figures import draw
from rig.shelf import shelf

Array = NDArray[np.float64]
DELAY = 1.5e-3  # s, of the table that foreign_data makes
LATE = 0.01  # s, of its gyro


def evidence(*parts: Part) -> Evidence:
    return Evidence(parts, (), tuple(part.name for part in parts), "A1", False, ())


def late(quantity: str, seconds: float) -> Term:
    return Term(shelf()["delay"], "rate" if quantity == "rate" else "acceleration", {"time": seconds})


def read(folder: Path, text: str, data: Mapping[str, Array], run: str) -> Foreign:
    """An imported run of one file."""
    path = folder / f"{run}.yaml"
    path.write_text(text, encoding="utf-8")
    table = Table("made", tuple(data), np.stack(list(data.values()), axis=1), {}, False)
    return Foreign(run, load(path), (table,), ())


def table(folder: Path, polarity: float = 0.0, run: str = "table") -> ResponseTable:
    """A delay at six frequencies, three repeats that scatter by 1e-3 in magnitude and 1e-4 rad in phase."""
    text, data = foreign_data.responding_manifest("d.csv"), foreign_data.responding(polarity)
    data["phase"] = data["phase"] + 1e-4 * np.random.default_rng(3).normal(size=18)
    (part,) = parts_of(read(folder, text, data, run))[0]
    assert isinstance(part, ResponseTable)
    return part


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> TrackedMotion:
    folder, data = tmp_path_factory.mktemp("turned"), foreign_data.turning(delay=LATE)
    (part,) = parts_of(read(folder, foreign_data.turning_manifest("d.csv"), data, "turned"))[0]
    assert isinstance(part, TrackedMotion)
    return part


def turns_and_poses(names: Sequence[str] = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z")) -> Poses:
    """Twenty attitudes, then two turns of 360° about each axis, of which the second overshoots by 2°."""
    random = np.random.default_rng(4)
    rates = np.array([name.startswith("gyro") for name in names])
    axis = np.array(["xyz".index(name[-1]) for name in names])
    n = 26
    turn, true = np.zeros((3, n)), np.zeros((3, n))
    for k in range(6):
        turn[k // 2, 20 + k] = 2.0 * math.pi
        true[k // 2, 20 + k] = 2.0 * math.pi + math.radians(2.0) * (k % 2)
    force = random.normal(size=(3, n))
    force *= 9.81 / np.linalg.norm(force, axis=0)
    clean = np.where(rates[:, None], true[axis] / 4.0, force[axis])
    count = len(names)
    made = Channels(
        names=tuple(names), rates=rates, axis=axis, slot=np.arange(count), side=np.full(count, math.nan),
        sensitivity=np.ones(count), tolerance=np.full(count, 0.2), pole=np.full(count, math.inf), unit=("u",) * count,
    )  # fmt: skip
    return Poses(PoseRecords(
        name="posed#0", run="posed", channels=made, observed=clean + 1e-4 * random.normal(size=clean.shape),
        variance=np.full(clean.shape, 1e-8), turn=turn, u_turn=np.where(turn.any(axis=0), 0.02, 0.0),
        seconds=np.full(n, 4.0), time=np.linspace(0.0, 125.0, n), held=np.arange(n) % 5 == 4,
        temperature=np.full(n, 23.0), supply=np.full(n, 5.0), gravity=9.81, u_gravity=1e-4,
    ))  # fmt: skip


def lines(ax: Axes, points: int = 3) -> list[tuple[Array, Array]]:
    """x and y of every line of at least so many points."""
    pairs = [(np.asarray(one.get_xdata(), float), np.asarray(one.get_ydata(), float)) for one in ax.get_lines()]
    return [(x, y) for x, y in pairs if len(x) >= points]


def line(ax: Axes, label: str) -> tuple[Array, Array]:
    (found,) = [one for one in ax.get_lines() if one.get_label() == label]
    return np.asarray(found.get_xdata(), float), np.asarray(found.get_ydata(), float)


def bars(ax: Axes) -> list[tuple[Array, Array]]:
    """x and y of the points of every series with bars."""
    found = [box.lines[0] for box in ax.containers]  # type: ignore[attr-defined]
    return [(np.asarray(one.get_xdata(), float), np.asarray(one.get_ydata(), float)) for one in found]


def heights(ax: Axes) -> Array:
    """Upper bound of the first band, at its vertices above zero."""
    (band, *_) = [one for one in ax.collections if isinstance(one, PolyCollection)]
    vertices = np.asarray(band.get_paths()[0].vertices)
    return np.asarray(vertices[vertices[:, 1] > 0.0, 1])


def legends(ax: Axes) -> list[str]:
    legend = ax.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


# tables of responses


def test_a_delay_that_the_model_lacks_is_drawn_as_the_phase_that_it_is(tmp_path: Path) -> None:
    part = table(tmp_path)
    magnitude, phase, _, over = response(evidence(part).fitted(), [0], []).axes
    ((f, measured),) = bars(phase)
    assert f.tolist() == [10.0, 20.0, 40.0, 80.0, 160.0, 250.0]
    assert measured == pytest.approx(-360.0 * f * DELAY, abs=0.02)
    assert bars(magnitude)[0][1] == pytest.approx(1.02, rel=2e-3)
    assert lines(phase)[0][1] == pytest.approx(0.0, abs=1e-3)
    *_, (x, left) = lines(over)
    assert left == pytest.approx(-360.0 * x * DELAY, abs=0.02)


def test_once_the_delay_is_in_the_model_its_line_meets_the_points_and_the_rest_is_in_the_band(tmp_path: Path) -> None:
    part = table(tmp_path)
    figure = response(evidence(part).fitted([late("acceleration", DELAY)]), [0], [])
    magnitude, phase, below, over = figure.axes
    assert lines(phase)[0][1] == pytest.approx(bars(phase)[0][1], abs=0.05)
    assert lines(magnitude)[0][1] == pytest.approx(bars(magnitude)[0][1], rel=3e-3)
    (_, single), (_, mean) = (one for one in lines(below) if len(one[0]) in (6, 18))
    assert len(single) == 18
    assert single.reshape(6, 3).mean(axis=1) == pytest.approx(mean, abs=1e-3)
    assert np.max(np.abs(mean)) < 2.0 * float(np.median(heights(below)))
    stated = 100.0 * math.hypot(1e-3, 1e-3 / math.sqrt(3.0)) / 1.02
    assert float(np.median(heights(below))) == pytest.approx(2.0 * stated, rel=0.25)
    assert [ax.get_ylabel()[-1] for ax in (below, over)] == ["%", "°"]


def test_a_response_that_counts_against_the_reference_is_drawn_the_right_way_round(tmp_path: Path) -> None:
    _, phase, _, _ = response(evidence(table(tmp_path, math.pi)).fitted(), [0], []).axes
    ((f, measured),) = bars(phase)
    assert measured == pytest.approx(-360.0 * f * DELAY, abs=0.02)


def test_tables_of_several_runs_share_a_figure_and_are_told_apart_by_name(tmp_path: Path) -> None:
    both = evidence(table(tmp_path, run="here"), table(tmp_path, run="there"), table(tmp_path, run="there"))
    magnitude, phase, below, _ = response(both.fitted(), [0, 1, 2], []).axes
    assert len(bars(phase)) == 3
    names = ["here", "there (1)", "there (2)"]
    assert sorted(legends(magnitude)) == sorted([*names, "model"])
    assert legends(below) == ["±2 σ of the noise", "repeats"]


# motion that a reference followed


def test_the_axis_with_the_largest_error_is_shown_in_time_and_what_is_left_is_the_difference(
    turned: TrackedMotion,
) -> None:
    fit = evidence(turned).fitted()
    gyro, acc, rest, _, _, _ = following(fit, 0, turned, []).axes
    assert gyro.get_ylabel() == "gyro_z_dps / (°/s)"
    assert acc.get_ylabel().endswith("/ (m/s²)")
    t, measured = line(gyro, "gyro_z_dps: measured")
    _, model = line(gyro, "model")
    (x, left), *_ = (one for one in lines(rest) if len(one[0]) == len(t))
    assert x.tolist() == t.tolist()
    assert left == pytest.approx(measured - model, abs=1e-9)
    true = 66.0 * np.cos(1.1 * t) + 72.5 * np.cos(2.9 * t + 0.4)
    rise = -66.0 * 1.1 * np.sin(1.1 * t) - 72.5 * 2.9 * np.sin(2.9 * t + 0.4)
    assert np.median(np.abs(model - true)) < 1.5  # less good at the ends of a stretch, which are not periodic
    assert np.polyfit(-rise, left, 1)[0] == pytest.approx(LATE, rel=0.15)


def test_the_stretch_shown_is_one_without_a_gap_and_of_some_seconds(turned: TrackedMotion) -> None:
    gyro = following(evidence(turned).fitted(), 0, turned, []).axes[0]
    t, _ = line(gyro, "gyro_z_dps: measured")
    assert np.diff(t) == pytest.approx(turned.data.interval, rel=1e-6)
    assert 2.0 <= t[-1] - t[0] <= 10.0


def test_the_spectrum_of_the_error_adds_up_to_the_error_that_is_compared(turned: TrackedMotion) -> None:
    found = compare(evidence(turned))
    spectrum = following(found.fit, 0, turned, []).axes[4]
    (group,) = [one for one in found.groups if one.name.endswith("gyros")]
    total = 0.0
    for name in group.channels:
        f, density = line(spectrum, name)
        total += float(np.trapezoid(density**2, f)) / len(group.channels)
    assert math.sqrt(total) == pytest.approx(math.degrees(group.error), rel=0.2)


def test_every_axis_has_its_spectrum_and_its_noise_and_only_what_moves_has_a_motion(turned: TrackedMotion) -> None:
    *_, gyros, accelerometers = following(evidence(turned).fitted(), 0, turned, []).axes
    bands = [one for one in gyros.collections if isinstance(one, PolyCollection) and one.get_paths()]
    assert len(bands) == 2
    dotted = [one for one in gyros.get_lines() if one.get_linestyle() == ":" and len(np.asarray(one.get_xdata())) > 3]
    assert [one.get_color() for one in dotted] == [gyros.get_lines()[-2].get_color()]
    assert legends(gyros) == ["gyro_x_dps", "gyro_z_dps", "noise", "motion"]
    assert legends(accelerometers) == ["acc_x_g", "acc_y_g", "acc_z_g", "noise", "motion"]
    assert (gyros.get_xscale(), gyros.get_yscale()) == ("log", "log")


def test_a_repaired_model_brings_the_spectrum_down_to_the_noise(turned: TrackedMotion) -> None:
    def worst(fit: Fit) -> float:
        ax = following(fit, 0, turned, []).axes[4]
        f, density = line(ax, "gyro_z_dps")
        noise = 0.2 * math.sqrt(2.0 * 0.01)  # foreign_data: 0.2 °/s at 100 Hz
        return float(np.median(density[(f > 0.15) & (f < 0.5)]) / noise)

    ev = evidence(turned)
    assert worst(ev.fitted()) > 10.0
    assert worst(ev.fitted([late("rate", LATE)])) < 2.5


# poses and turns


def test_what_was_left_out_is_marked_in_time_and_said_below_and_held_out_pieces_are_hatched(tmp_path: Path) -> None:
    foreign = rotation(Unit(), 5, rest=0.0, seconds=30.0, channels="r", jitter=1e-4)
    (made,) = foreign.tables
    column = made.names.index("gyro_z")
    made.values[:, column] = np.minimum(made.values[:, column], 1.5)
    (part,) = parts_of(foreign)[0]
    assert isinstance(part, TrackedMotion)
    assert part.data.kept is not None
    fit = evidence(part).fitted()
    figure = following(fit, 0, part, [])
    top, below, _ = figure.axes
    low, high = top.lines[0].get_xdata()[[0, -1]]
    red = [(one.get_x(), one.get_x() + one.get_width()) for one in top.patches]
    cut = [one for fault in part.faults for one in fault.times if one[0] < high and one[1] > low]
    assert len(red) == len(cut) > 0
    assert all(a < b and a <= first <= last <= b for (a, b), (first, last) in zip(red, cut, strict=True))
    inside = np.logical_or.reduce([(top.lines[0].get_xdata() > a) & (top.lines[0].get_xdata() < b) for a, b in cut])
    for drawn in (top.lines[0], below.lines[1]):  # nothing is made up where nothing was measured
        assert np.isnan(drawn.get_ydata()[inside]).all()
        assert np.isfinite(drawn.get_ydata()).sum() > 0.5 * np.sum(~inside)
    assert {one.get_label() for one in below.patches} <= {NOISE, "held out"}
    (path,) = draw(evidence(part), fit, tmp_path)
    assert "gyro_z: clipped at the top" in path.read_text(encoding="utf-8")


def test_a_long_finding_is_said_whole_below_a_figure_and_of_many_how_many_more_there_are(tmp_path: Path) -> None:
    (part,) = parts_of(rotation(Unit(), 5, rest=0.0, seconds=30.0, channels="r", jitter=1e-4))[0]
    assert isinstance(part, TrackedMotion)
    said = [Finding("alone", "log", f"{n} " + " ".join(f"word{n}{k}" for k in range(40))) for n in range(5)]
    part.faults = tuple(said)
    (path,) = draw(evidence(part), evidence(part).fitted(), tmp_path)
    drawn = path.read_text(encoding="utf-8")
    assert all(f"word{n}{k}" in drawn for n in range(3) for k in range(40))
    assert "and 2 more: see findings" in drawn
    assert "…" not in drawn


def test_the_poses_are_off_by_what_is_said_of_them() -> None:
    part = turns_and_poses()
    fit = evidence(part).fitted()
    gravity = poses(fit, 0, part, []).axes[0]
    x, above = lines(gravity, 20)[0]
    said = part.remarks(fit.left, fit.state.local(part, 0), fit.state.terms)[0]
    assert x.tolist() == list(range(1, 21))
    assert f"magnitude less g: {math.sqrt(float(np.mean(above**2))):.5f} m/s²" in said
    assert float(heights(gravity).max()) == pytest.approx(2e-4, rel=1e-3)
    marked = [one for one in gravity.get_lines() if one.get_linestyle() == "None"]
    assert sum(len(np.asarray(one.get_xdata())) for one in marked) == 20
    assert gravity.get_ylabel() == "magnitude − g / (m/s²)"


def test_turns_are_off_by_the_angles_that_are_said_of_them() -> None:
    part = turns_and_poses()
    fit = evidence(part).fitted()
    turns = poses(fit, 0, part, []).axes[2]
    said = " ".join(part.remarks(fit.left, fit.state.local(part, 0), fit.state.terms))
    assert [len(x) for x, _ in bars(turns)] == [2, 2, 2]
    for _, off in bars(turns):
        assert off[1] - off[0] == pytest.approx(2.0, abs=0.1)
        assert all(f"integrates to {360.0 + one:.2f}°" in said for one in off)
    assert [text.get_text() for text in turns.get_xticklabels()] == [f"{a}, +360°" for a in "xxyyzz"]


def test_a_record_of_gyros_alone_has_no_panel_of_gravity() -> None:
    part = turns_and_poses(("gyro_x", "gyro_y", "gyro_z"))
    rest, turns = poses(evidence(part).fitted(), 0, part, []).axes
    assert rest.get_ylabel() == "rate at rest / (°/s)"
    assert len(lines(rest, 20)) == 3
    assert turns.get_ylabel() == "shown − known angle / °"


# all together


def test_every_kind_of_part_has_its_figure_and_tables_share_one(turned: TrackedMotion, tmp_path: Path) -> None:
    made = evidence(table(tmp_path, run="a"), turned, table(tmp_path, run="b"), turns_and_poses())
    paths = draw(made, made.fitted(), tmp_path / "figures", ("svg", "png"))
    stems = ["misfit_rotation", "misfit_poses", "misfit_response"]
    assert [path.name for path in paths] == [f"{stem}.{kind}" for stem in stems for kind in ("svg", "png")]
    texts = {path.stem: path.read_text(encoding="utf-8") for path in paths if path.suffix == ".svg"}
    assert all("<!-- ±2 σ of the noise -->" in text for text in texts.values())
    assert "<!-- a -->" in texts["misfit_response"]
    assert "<!-- turned: what the model leaves over" in texts["misfit_rotation"]


def test_an_imported_sweep_at_one_frequency_is_drawn_over_its_level(tmp_path: Path) -> None:
    made = evidence(*parts_of(imported_sweeps.made())[0])
    (svg,) = draw(made, made.fitted(), tmp_path)
    assert svg.name == "misfit_shaker.svg"
    text = svg.read_text(encoding="utf-8")
    assert "<!-- amplitude of the reference at 5.17 Hz / (m/s²) -->" in text
    assert "<!-- frequency / Hz -->" not in text
