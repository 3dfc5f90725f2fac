"""A calibration by a repaired model: flagged without the effect that the sensor has, sound with it.

The bench hides a quadratic nonlinearity of the accelerometers; all goes through the command line.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fast_bench
import pytest
import yaml
from click.testing import CliRunner

from rig.calibrate.calibration import MISSING
from rig.cli import cli
from rig.errors import BadInput

COEFFICIENT = 1e-3
SWEEP = {"procedure": "frequency_sweep", "axis": "x", "start": "20 Hz", "stop": "400 Hz", "points": 10,
         "levels": ["full", "quarter"]}  # fmt: skip
HIDDEN = [{"name": "quadratic", "parameters": {"quantity": "acceleration", "coefficient": COEFFICIENT}}]
WORLD = fast_bench.world(3, HIDDEN)


def said(runs: Path, *words: str) -> str:
    done = CliRunner().invoke(cli, [*words, "--runs", str(runs)], catch_exceptions=False, standalone_mode=False)
    return done.stdout


def results(runs: Path, *words: str) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    found = json.loads(said(runs, "calibrate", "last", *words, "--json"))
    return found, {row["key"]: row for row in found["results"]}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sweep, and a model of it with the effect that is hidden."""
    folder = tmp_path_factory.mktemp("by-model")
    fast_bench.keep(SWEEP, WORLD, folder)
    said(folder, "add", "quadratic", "--on", "acceleration", "last")
    return folder


@pytest.fixture(scope="module")
def by_model(runs: Path) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    return results(runs)


def sensitivity(channel: str) -> float:
    return float(WORLD.truth["sensitivity"][channel])


def test_without_the_effect_a_sensitivity_is_flagged_and_says_nothing_of_its_limits(runs: Path) -> None:
    found, rows = results(runs, "--model", "none")
    assert found["model"] == "data sheet"
    row = rows["unit_a_x.sensitivity"]
    assert row["status"] == "flagged"
    assert row["verdict"] == "inconclusive"
    assert any("an effect is missing" in remark for remark in row["remarks"])


def test_by_the_repaired_model_it_is_not_flagged_and_the_truth_lies_in_its_interval(by_model: Any) -> None:
    _, rows = by_model
    for name in ("unit_a_x", "unit_b_x", "unit_c_x"):
        row = rows[f"{name}.sensitivity"]
        assert row["status"] == "determined", row["remarks"]
        assert row["verdict"] == "pass"
        assert abs(row["value"] - sensitivity(name)) < row["expanded"]


def test_what_the_effect_is_stands_among_the_results(by_model: Any) -> None:
    _, rows = by_model
    row: Mapping[str, Any] = next(one for key, one in rows.items() if key.endswith("quadratic_coefficient"))
    assert abs(row["value"] - COEFFICIENT) < 2.0 * row["expanded"]
    assert row["unit"] == "1/(m/s²)"


def test_the_model_is_named_with_its_digest_wherever_the_values_go(runs: Path, by_model: Any, tmp_path: Path) -> None:
    found, _ = by_model
    file = runs / "models" / "SIM-CUBE-1.yaml"
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    wanted = f"data sheet + quadratic (acceleration) ({file.name}, SHA-256 {digest})"
    assert found["model"] == wanted
    assert yaml.safe_load(Path(found["path"]).read_text(encoding="utf-8"))["model"] == wanted
    said(runs, "certify", "last", "--name", "signed", "--out", str(tmp_path))
    signed = (tmp_path / "signed.xml").read_text(encoding="utf-8")
    assert digest in signed
    assert "direct estimates agree" in signed
    said(runs, "report", "last", "--out", str(tmp_path / "page.html"))
    assert digest in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_how_many_direct_estimates_agree_is_one_line(runs: Path) -> None:
    text = said(runs, "calibrate", "last")
    assert "model: data sheet + quadratic (acceleration) (SIM-CUBE-1.yaml, SHA-256 " in text
    assert sum("direct estimates agree; the furthest, of " in line for line in text.splitlines()) == 1


def test_the_next_commands_carry_the_model(runs: Path) -> None:
    file = runs / "models" / "SIM-CUBE-1.yaml"
    text = said(runs, "calibrate", "last", "--model", str(file))
    lines = [line for line in text.splitlines() if line.startswith("next: ")]
    assert all(("--model" in line) == ("export" not in line) for line in lines)
    assert len(lines) == 3


def test_where_an_effect_is_missing_it_is_said_once_of_all_values_and_the_way_to_its_name_comes_first(
    tmp_path: Path,
) -> None:
    fast_bench.keep(SWEEP, fast_bench.world(3, HIDDEN), tmp_path)
    lines = said(tmp_path, "calibrate", "last").splitlines()
    said_of = dict(line.split(": ", 2)[:0:-1] for line in lines if line.startswith("  flagged: "))
    assert len(said_of) == sum(line.startswith("  flagged: ") for line in lines)
    assert [keys for remark, keys in said_of.items() if MISSING in remark and "unit_a_x.sensitivity, " in keys]
    assert next(line for line in lines if line.startswith("next: ")).startswith("next: rig diagnose last")
    assert not [
        line for line in said(tmp_path, "calibrate", "last", "--model", "none").splitlines() if "diagnose" in line
    ]


def test_another_unit_s_model_is_refused(runs: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text((runs / "models" / "SIM-CUBE-1.yaml").read_text(encoding="utf-8").replace("SIM-CUBE-1", "OTHER"))
    with pytest.raises(BadInput, match="found a model of OTHER, wanted one of SIM-CUBE-1"):
        said(runs, "calibrate", "last", "--model", str(other))
