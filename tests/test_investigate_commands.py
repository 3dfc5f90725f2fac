"""Go on measuring until a model is understood: floor, next, investigate and the demonstration, over sockets.

The bench hides a cubic nonlinearity of the accelerometers.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from rig import open_run
from rig.bench import control
from rig.bench.assembly import state_folder
from rig.bench.benchfile import describe
from rig.cli import cli
from rig.errors import BadInput
from rig.yaml.config import shipped

CUBIC = {"name": "cubic", "parameters": {"quantity": "acceleration", "coefficient": 3e-4}}
REMOUNTS = {
    "title": "three mountings",
    "steps": [{"repeat": 3, "steps": [{"procedure": "frequency_sweep", "axis": "x", "points": 6, "levels": ["full"]}]}],
}


def said(runs: Path, *words: str) -> str:
    """What a command prints; raises what it raises. There is no terminal."""
    done = CliRunner().invoke(cli, [*words, "--runs", str(runs)], catch_exceptions=False, standalone_mode=False)
    return done.stdout


def asked(runs: Path, *words: str) -> Any:
    return json.loads(said(runs, *words, "--json"))


def _bench(folder: Path, hidden: list[dict[str, Any]]) -> Path:
    """A bench file whose world hides this."""
    ours = shipped("benches/simulated.yaml")
    world = yaml.safe_load((ours.parent / "../worlds/clean.yaml").read_text(encoding="utf-8"))
    (folder / "world.yaml").write_text(yaml.safe_dump({**world, "hidden": hidden}, allow_unicode=True))
    text = ours.read_text(encoding="utf-8").replace("../worlds/clean.yaml", str(folder / "world.yaml"))
    (folder / "bench.yaml").write_text(text.replace("../", f"{ours.parent.parent}/"), encoding="utf-8")
    return folder / "bench.yaml"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _bench(tmp_path_factory.mktemp("investigate"), [CUBIC])


@pytest.fixture(scope="module")
def runs(bench: Path) -> Iterator[Path]:
    yield bench.parent / "runs"
    control.stop(state_folder(describe(bench), bench.parent / "runs"))


@pytest.fixture(scope="module")
def investigated(bench: Path, runs: Path) -> Any:
    return asked(runs, "investigate", "--only", "shaker", "--yes", "--bench", str(bench))


def _taken(runs: Path) -> list[str]:
    return sorted(path.parent.name for path in runs.glob("*/journal.jsonl"))


def test_an_investigation_ends_with_an_adequate_model_that_has_the_hidden_effect(investigated: Any, runs: Path) -> None:
    assert set(investigated) == {"verdict", "runs", "effects", "undecided_between", "model"}
    assert investigated["undecided_between"] == []
    assert investigated["verdict"] == "adequate"
    assert investigated["effects"] == ["cubic"]
    assert investigated["runs"] == _taken(runs)
    model = yaml.safe_load(Path(investigated["model"]).read_text(encoding="utf-8"))
    assert [one["effect"] for one in model["effects"]] == ["cubic"]
    value = model["effects"][0]["parameters"]["coefficient"]
    assert abs(value["value"] - 3e-4) < 3.0 * value["u"]
    assert set(model["runs"]) == set(investigated["runs"])


def test_without_anybody_to_ask_nothing_is_measured(bench: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"found no terminal.*--yes"):
        said(tmp_path / "runs", "investigate", "--bench", str(bench))
    with pytest.raises(BadInput, match="found --json, wanted --yes"):
        said(tmp_path / "runs", "investigate", "--json", "--bench", str(bench))
    assert not (tmp_path / "runs").exists()


def test_who_says_no_is_left_in_peace(bench: Path, tmp_path: Path) -> None:
    master, slave = os.openpty()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RIG_")}
    os.write(master, b"n\n")
    done = subprocess.run(
        [sys.executable, "-m", "rig", "investigate", "--bench", str(bench), "--runs", str(tmp_path / "runs")],
        stdin=slave, capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    os.close(master)
    os.close(slave)
    assert done.returncode == 0, done.stderr
    assert "measure: Frequency sweep, x, about" in done.stdout
    assert done.stdout.count("take it?") == 1
    last = f"next: rig sweep --axis x --bench {bench} --runs {tmp_path / 'runs'}\n"
    assert done.stdout.endswith(f"nothing was measured\n{last}")
    assert not _taken(tmp_path / "runs")


def test_next_says_what_was_not_measured_when_nothing_is_open(investigated: Any, bench: Path, runs: Path) -> None:
    name = investigated["runs"][0]
    text = said(runs, "next", name, "--bench", str(bench)).splitlines()
    assert text[0] == "nothing is open between two effects: the model leaves nothing but noise in these runs"
    wanted = f"rig turntable --all --bench {bench} --runs {runs}"
    assert any(line.endswith(f"  {wanted}") for line in text)
    assert text[-1] == f"next: {wanted}"
    found = asked(runs, "next", name, "--bench", str(bench))
    assert found["measurements"] == []
    assert found["procedure"] is None
    assert found["unmeasured"][0]["command"] == wanted


def test_next_without_a_model_says_what_to_add(investigated: Any, bench: Path, runs: Path) -> None:
    name, model = investigated["runs"][0], str(runs / "none.yaml")
    text = said(runs, "next", name, "--bench", str(bench), "--model", model).splitlines()
    assert text[0] == "nothing is open between two effects: what is missing is cubic"
    assert text[-1] == f"next: rig add cubic {name} --on acceleration --model {model} --runs {runs}"


def test_a_floor_is_measured_from_three_mountings_and_kept_for_the_next_fit(
    investigated: Any, bench: Path, runs: Path, tmp_path: Path
) -> None:
    procedure = tmp_path / "remounts.yaml"
    procedure.write_text(yaml.safe_dump(REMOUNTS), encoding="utf-8")
    with pytest.raises(BadInput, match="found 1 mountings of one axis, wanted at least 3"):
        said(runs, "floor", investigated["runs"][0])
    before = asked(runs, "diagnose", investigated["runs"][0])["cannot_see"]
    said(runs, "run", str(procedure), "--bench", str(bench))
    found = asked(runs, "floor", "last")
    assert found["mountings"] == 3
    assert found["size"] < 2e-3
    text = said(runs, "floor", "last").splitlines()
    assert text[0].startswith("floor: ")
    assert text[1] == f"floor: {runs / 'floor.yaml'}"
    assert text[-1] == f"next: rig diagnose last --runs {runs}"
    after = asked(runs, "diagnose", investigated["runs"][0])["cannot_see"]
    assert any("floor is not known" in line for line in before)
    assert not any("floor is not known" in line for line in after)
    (runs / "floor.yaml").unlink()


@pytest.fixture(scope="module")
def delayed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A bench with a dead time so short that no sweep tells it from a filter; its bench file."""
    yield from _swept(tmp_path_factory.mktemp("delayed"), 2e-5)


@pytest.fixture(scope="module")
def open_question(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A bench with a longer one, which a sweep over a wider band tells from a filter; its bench file."""
    yield from _swept(tmp_path_factory.mktemp("open"), 6e-5)


def _swept(folder: Path, time: float) -> Iterator[Path]:
    path = _bench(folder, [{"name": "delay", "parameters": {"quantity": "acceleration", "time": time}}])
    said(folder / "runs", "sweep", "--axis", "x", "--bench", str(path))
    yield path
    control.stop(state_folder(describe(path), folder / "runs"))


def test_what_no_measurement_would_decide_is_said_to_be_one_class(delayed: Path) -> None:
    runs, bench = delayed.parent / "runs", str(delayed)
    lines = said(runs, "next", "last", "--bench", bench).splitlines()
    assert any("none is expected to decide" in line and line.endswith("they are one class") for line in lines)
    assert lines[-1].startswith(f"next: rig add delay {_taken(runs)[0]}")


def test_next_writes_a_procedure_that_the_bench_accepts(open_question: Path) -> None:
    runs, bench = open_question.parent / "runs", str(open_question)
    name = _taken(runs)[0]
    found = asked(runs, "next", "last", "--bench", bench)
    assert found["verdict"] == "missing"
    first = found["measurements"][0]
    assert set(first) == {"name", "why", "power", "decides", "between", "minutes", "procedure"}
    assert first["name"].startswith("wider band")
    assert len(found["measurements"]) > 4
    lines = said(runs, "next", "last", "--bench", bench).splitlines()
    path = next(line.removeprefix("procedure: ") for line in lines if line.startswith("procedure: "))
    assert path == found["procedure"]
    assert lines[1].split("  ")[1] == first["name"]
    assert first["decides"]
    where = f"--runs {runs}"
    assert lines[-1] == f"next: rig run {path} --bench {bench} {where} && rig diagnose {name} last {where}"
    dry = said(runs, "run", path, "--dry-run", "--bench", bench)
    assert first["name"] in dry
    assert _taken(runs) == [name]


def test_an_investigation_takes_the_measurement_that_would_decide(open_question: Path) -> None:
    runs = open_question.parent / "runs"
    found = asked(runs, "investigate", "--only", "shaker", "--yes", "--bench", str(open_question))
    assert found["verdict"] in {"adequate", "undecided"}
    highest = [_highest(runs / name) for name in found["runs"]]
    assert highest[0] < 510.0
    assert highest[1] > 950.0  # Hz: the wider band


def _highest(run: Path) -> float:
    """Hz."""
    return max(float(point["frequency"]) for point in open_run(run).points.values() if "frequency" in point)


def test_the_demonstration_hides_an_effect_that_the_bench_reveals(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    bench = _bench(tmp_path, [])
    try:
        found = asked(runs, "demo", "hidden", "--seed", "3", "--yes", "--bench", str(bench))
        assert set(found) == {"runs"}
        assert sorted(found["runs"]) == _taken(runs)
        (hidden,) = effects = asked(runs, "bench", "reveal", "--bench", str(bench))["effects"]
        assert hidden["found"] is None
        on = ("--on", hidden["quantity"]) if hidden["quantity"] else ()
        said(runs, "add", hidden["name"], *found["runs"], *on)
        (hidden,) = asked(runs, "bench", "reveal", "--bench", str(bench))["effects"]
        assert set(hidden["found"]) <= set(hidden["parameters"])
        for name, value in hidden["found"].items():
            assert abs(value["value"] - hidden["parameters"][name]) < 4.0 * value["u"], name
            assert value["unit"] == hidden["units"][name]
        assert "found" in said(runs, "bench", "reveal", "--bench", str(bench))
        with pytest.raises(BadInput, match="use another folder") as refused:
            said(runs, "demo", "hidden", "--seed", "4", "--yes", "--bench", str(bench))
        assert effects[0]["name"] not in str(refused.value)
        assert "hides something else" in str(refused.value)
    finally:
        control.stop(state_folder(describe(bench), runs))
