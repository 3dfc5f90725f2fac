"""The report: one file with everything in it, the paper's tables and figures, and a word about what is missing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from html.parser import HTMLParser
from pathlib import Path

import fast_bench
import pytest
from example_calibration import example

from rig.archive.records import Recorded
from rig.calibrate.calibration import Calibration, text
from rig.report import figures, write_report
from rig.report.page import page, table


@lru_cache(maxsize=1)
def runs() -> tuple[Recorded, ...]:
    """A turntable run, a small sweep and a noise record of one simulated unit."""
    world = fast_bench.world(3)
    turning = {"procedure": "turntable", "speed": "45 rpm", "axis": "roll", "revolutions": 4, "rest": "1 s"}
    sweep = {"procedure": "frequency_sweep", "axis": "x", "points": 3, "static": "0 s", "levels": ["full"]}
    return tuple(fast_bench.measure(one, world) for one in (turning, sweep, {"procedure": "noise", "length": "10 s"}))


def upright() -> Calibration:
    """The example with the roll gyros' sign as the simulated unit has it."""
    made = example()
    return replace(
        made,
        results=tuple(
            replace(r, value=-r.value) if r.channel.endswith("roll") and r.measurand == "sensitivity" and r.value else r
            for r in made.results
        ),
    )


class Page(HTMLParser):
    """Tags, references and text of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        self.ids += [value or "" for name, value in attrs if name == "id" and tag == "g"]
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_whole_and_asks_for_nothing_from_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(upright(), runs(), path)
    read = Page()
    read.feed(path.read_text(encoding="utf-8"))
    assert read.open == []
    assert not {"script", "link", "img", "iframe"} & set(read.tags)
    assert all(link.startswith("#") for link in read.links)
    assert read.tags.count("svg") == len(figures.PLANS)
    assert len(read.ids) == len(set(read.ids))
    assert path.stat().st_size < 3_000_000


def test_the_same_runs_give_the_same_bytes() -> None:
    assert page(upright(), runs()[:1]) == page(upright(), runs()[:1])


def test_every_value_of_the_calibration_is_on_the_page_with_its_uncertainty() -> None:
    made = upright()
    whole = page(made, runs()).replace("&#39;", "'")
    assert all(text(result) in whole for result in made.results)
    assert all(found in whole for found in (made.serial, "EX-LDV-2026-014", "650 (reference 660)", "inconclusive"))


def test_a_simulated_calibration_says_so_and_a_real_one_does_not() -> None:
    assert "SIMULATED" in page(upright(), [])
    assert "SIMULATED" not in page(replace(upright(), simulated=False), [])


def test_what_the_runs_do_not_allow_is_listed_with_the_command_that_gives_it() -> None:
    whole = page(replace(example(), responses={}), [])
    assert "<svg" not in whole
    for plan in figures.PLANS:
        assert re.search(rf"{re.escape(plan.title)}: no run .*<code>{plan.command}</code>", whole)


def test_texts_from_a_bench_file_stay_texts() -> None:
    whole = page(replace(example(), serial="<script>alert(1)</script>"), [])
    assert "<script>" not in whole
    assert "&lt;script&gt;" in whole


def test_a_table_row_shows_how_far_the_paper_is_from_the_calibration() -> None:
    (row,) = table(example(), "II")
    assert (row.row, row.channel, row.nominal, row.unit) == ("Pitch", "gyro_pitch", "3.49", "mV/(°/s)")
    assert row.ours.startswith("3.610 ± ")
    (estimate,) = row.estimates
    assert (estimate.name, estimate.value, estimate.away) == ("eq. 13", "3.630", "+0.55 %")


def test_figure_four_has_the_amplitude_that_the_vibrometer_saw() -> None:
    drawing = figures.figure_4(runs())
    assert drawing is not None
    (line,) = drawing.figure.axes[0].get_lines()
    body = min((b for b in runs()[1].points.values() if "frequency" in b), key=lambda b: abs(b["frequency"] - 67.0))
    assert max(line.get_ydata()) == pytest.approx(body["velocity"] * 1e3, rel=0.02)
    assert runs()[1].name in drawing.caption


def test_figure_nine_is_nearer_to_the_reference_with_the_calibrated_sensitivity() -> None:
    made = upright()
    truth = dict.fromkeys(("gyro_roll",), fast_bench.world(3).truth["sensitivity"]["gyro_roll"])
    made = replace(
        made,
        results=tuple(
            replace(r, value=truth[r.channel]) if r.key == "gyro_roll.sensitivity" else r for r in made.results
        ),
    )
    drawing = figures.figure_9(made, runs())
    assert drawing is not None
    default, calibrated = (line.get_ydata() for line in drawing.figure.axes[1].get_lines()[:2])
    assert abs(calibrated[-100:].mean()) < 0.5 * abs(default[-100:].mean())
