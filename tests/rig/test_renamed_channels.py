"""Channels by other names than the shipped ones: what cannot be had of them is left out or said."""

from __future__ import annotations

from pathlib import Path

import fast_bench
import pytest

from rig.bench.steps import Plan
from rig.cli.outcome import concluded, unmet
from rig.report import run_figures as figures
from rig.yaml.config import shipped

NAMES = (("unit_", "acc_"), ("gyro_", "turn_"), ("backup_", "spare_"))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped bench and sensor file with every channel renamed."""
    root, folder = shipped("benches/simulated.yaml").parents[1], tmp_path_factory.mktemp("renamed")
    for path in root.rglob("*.yaml"):
        copy, text = folder / path.relative_to(root), path.read_text(encoding="utf-8")
        copy.parent.mkdir(parents=True, exist_ok=True)
        if path.parent.name in ("benches", "sensors"):
            for old, new in NAMES:
                text = text.replace(old, new)
        copy.write_text(text, encoding="utf-8")
    return folder / "benches" / "simulated.yaml"


@pytest.mark.parametrize(
    "document",
    [
        {"procedure": "frequency_sweep", "axis": "x", "points": 3},
        {"procedure": "turntable", "revolutions": 2, "rest": "5 s"},
        {"procedure": "tumble"},
    ],
    ids=lambda one: str(one["procedure"]),
)
def test_a_run_is_drawn_and_concluded_whatever_its_channels_are_called(
    document: dict[str, object], bench: Path, tmp_path: Path
) -> None:
    records = fast_bench.measure(document, fast_bench.world(3), bench=bench)
    made, why = concluded(records)  # type: ignore[arg-type]
    assert made is not None or why
    figures.draw(records, made, tmp_path)  # type: ignore[arg-type]


def test_what_is_expected_and_not_determined_is_not_met() -> None:
    plan = Plan("t", "frequency_sweep", {}, (), expect={"acc_a_x.sensitivity": (0.06, 0.07)})
    said = "expect acc_a_x.sensitivity: found none in this run, wanted a sweep that determines it"
    assert list(unmet(plan, None)) == [said]
    assert list(unmet(Plan("t", "frequency_sweep", {}, ()), None)) == []
