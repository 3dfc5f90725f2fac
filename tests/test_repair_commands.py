"""Compare, see where it fails, learn what is missing, add it, watch the error fall: through the command line.

The bench hides a cubic nonlinearity of the accelerometers; runs come over its sockets.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import in_process
import pytest
import yaml
from click.testing import CliRunner

from rig.bench import control
from rig.bench.assembly import state_folder
from rig.bench.benchfile import describe
from rig.cli import cli
from rig.errors import BadInput
from rig.yaml.config import shipped

HIDDEN = {"name": "cubic", "parameters": {"quantity": "acceleration", "coefficient": 3e-4}}


def rig(runs: Path, *words: str, wanted: int = 0) -> in_process.Done:
    done = in_process.rig(*words, "--runs", str(runs))
    assert done.returncode == wanted, (words, done.stdout[-1500:], done.stderr[-1500:])
    assert "Traceback" not in done.stderr
    return done


def said(runs: Path, *words: str) -> str:
    """The same in this process, which is quicker; raises what the command raises."""
    done = CliRunner().invoke(cli, [*words, "--runs", str(runs)], catch_exceptions=False, standalone_mode=False)
    return done.stdout


def asked(runs: Path, *words: str) -> Any:
    return json.loads(said(runs, *words, "--json"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One short sweep on a bench with a hidden effect."""
    folder = tmp_path_factory.mktemp("repair")
    shipped_bench = shipped("benches/simulated.yaml")
    world = yaml.safe_load((shipped_bench.parent / "../worlds/clean.yaml").read_text(encoding="utf-8"))
    (folder / "world.yaml").write_text(yaml.safe_dump({**world, "hidden": [HIDDEN]}, allow_unicode=True))
    bench = shipped_bench.read_text(encoding="utf-8").replace("../worlds/clean.yaml", str(folder / "world.yaml"))
    bench = bench.replace("seed: 1}", "seed: 2}")
    path = folder / "bench.yaml"
    path.write_text(bench.replace("../", f"{shipped_bench.parent.parent}/"), encoding="utf-8")
    rig(folder / "runs", "sweep", "--axis", "x", "--points", "8", "--bench", str(path))
    yield folder / "runs"
    control.stop(state_folder(describe(path), folder / "runs"))


@pytest.fixture(scope="module")
def diagnosis(runs: Path) -> Mapping[str, Any]:
    """What `rig diagnose --json` says of it, before anything was added."""
    found: Mapping[str, Any] = asked(runs, "diagnose", "last", "--model", str(runs / "none.yaml"))
    return found


def test_the_hidden_effect_is_named_with_its_true_size(diagnosis: Mapping[str, Any]) -> None:
    assert diagnosis["verdict"] == "missing"
    first = diagnosis["candidates"][0]
    assert first["effect"] == "cubic"
    assert first["on"] == "acceleration"
    assert first["class"][0] == "cubic"
    value = first["parameters"]["coefficient"]
    assert value["unit"] == "1/(m/s²)²"
    assert abs(value["value"] - 3e-4) < 3.0 * value["u"]


def test_every_candidate_says_what_it_removes_why_and_what_would_tell_it_apart(diagnosis: Mapping[str, Any]) -> None:
    assert set(diagnosis) == {
        "verdict", "groups", "candidates", "excluded", "untold", "findings", "description", "cannot_see", "error",
        "heldout_error", "error_after", "heldout_error_after", "worst_at", "worst_after", "references",
    }  # fmt: skip
    before = max(group["ratio"] for group in diagnosis["groups"])
    for one in diagnosis["candidates"]:
        assert set(one) == {
            "effect", "on", "class", "probability", "error_after", "heldout_error_after", "parameters", "plausible",
            "because", "separate_by", "step", "taken", "worst_after",
            "not_known_apart", "depends_on_band", "channels",
        }  # fmt: skip
        assert 0.0 <= one["probability"] <= 1.0
        assert one["effect"] in one["class"]
        assert one["because"]
        assert one["separate_by"]
    first = diagnosis["candidates"][0]
    assert before > 1.5
    assert first["error_after"] == pytest.approx(1.0, abs=0.15)
    assert first["heldout_error_after"] == pytest.approx(1.0, abs=0.25)


def test_a_diagnosis_says_what_this_data_cannot_see(diagnosis: Mapping[str, Any]) -> None:
    limits = "\n".join(diagnosis["cannot_see"])
    assert "no turntable run" in limits
    assert "driven along x only" in limits
    assert "sensitivity: " in limits
    assert "one drive level only" not in limits


def test_one_level_only_is_said(runs: Path) -> None:
    bench = str(runs.parent / "bench.yaml")
    rig(runs, "sweep", "--axis", "x", "--points", "2", "--levels", "full", "--bench", bench)
    limits = asked(runs, "diagnose", "last", "--model", str(runs / "none.yaml"))["cannot_see"]
    assert any("one drive level only" in line for line in limits)


def test_comparing_shows_where_the_model_fails_and_draws_it(runs: Path, first_run: str) -> None:
    found = asked(runs, "compare", first_run, "--model", str(runs / "none.yaml"), "--png")
    assert set(found) == {"groups", "error", "heldout_error", "worst_at", "worst", "references", "findings", "figures"}
    assert found["groups"]
    assert 1 <= len(found["worst"]) <= 3
    assert all(Path(path).read_bytes() for path in found["figures"])
    assert {Path(path).suffix for path in found["figures"]} == {".svg", ".png"}
    assert {Path(path).parent for path in found["figures"]} == {runs / "reports" / first_run}


def test_comparing_draws_only_what_is_asked_and_says_how_to_ask(runs: Path, first_run: str) -> None:
    words = ("compare", first_run, "--model", str(runs / "none.yaml"))
    assert asked(runs, *words)["figures"] == []
    (asking,) = re.findall(r"^figures: rig (.*)$", said(runs, *words), re.MULTILINE)
    assert "--figures" in asking
    assert {Path(path).suffix for path in asked(runs, *words, "--figures")["figures"]} == {".svg"}


@pytest.fixture(scope="module")
def first_run(runs: Path) -> str:
    """The sweep with two levels."""
    return sorted(path.name for path in runs.iterdir() if (path / "journal.jsonl").exists())[0]


def test_adding_it_brings_the_error_to_the_noise_and_removing_it_brings_it_back(
    runs: Path, first_run: str, tmp_path: Path
) -> None:
    file = ("--model", str(tmp_path / "model.yaml"))
    added = asked(runs, "add", "cubic", first_run, *file)
    assert added["before"]["error"] > 1.3
    assert added["after"]["error"] == pytest.approx(1.0, abs=0.15)
    assert asked(runs, "diagnose", first_run, *file)["verdict"] == "adequate"
    assert "next: rig" in said(runs, "remove", "cubic", first_run, *file)
    ladder = asked(runs, "history", first_run, *file)
    assert [(step["action"], step["effect"]) for step in ladder["history"]] == [
        ("start", None), ("add", "cubic"), ("remove", "cubic"),
    ]  # fmt: skip
    first, second, third = (step["error"] for step in ladder["history"])
    assert math.isclose(first, third, rel_tol=1e-3)
    assert second < first
    assert {Path(path).suffix for path in ladder["figures"]} == {".svg", ".png"}


def test_the_model_of_the_unit_is_the_default_of_every_command(runs: Path, first_run: str) -> None:
    said(runs, "fit", first_run)
    path = runs / "models" / "SIM-CUBE-1.yaml"
    assert yaml.safe_load(path.read_text(encoding="utf-8"))["start"] == "datasheet"
    assert "start" in said(runs, "history", first_run)
    with pytest.raises(BadInput, match="found paper, wanted datasheet"):
        said(runs, "diagnose", first_run, "--start", "paper")


def test_a_diagnosis_in_words_ends_with_what_to_do_next_and_exit_code_0(runs: Path, first_run: str) -> None:
    done = rig(runs, "diagnose", first_run, "--model", str(runs / "none.yaml"))
    assert done.stdout.splitlines()[1].startswith("verdict: missing cubic")
    model = f"--model {runs / 'none.yaml'} --runs {runs}"
    assert done.stdout.splitlines()[-1] == f"next: rig add cubic {first_run} --on acceleration {model}"
    assert "%/g²" in done.stdout
    assert "SIMULATED" in done.stdout


def test_a_formula_of_ones_own_brings_the_error_down_and_stands_in_the_model_file(
    runs: Path, first_run: str, tmp_path: Path
) -> None:
    file = ("--model", str(tmp_path / "model.yaml"))
    term = ("--formula", "k*sin(u/w)", "--start", "w=2 g", "--start", "w=1 g")  # a cubic is its first bend
    driven = ("--on", "unit_a_x", "--on", "unit_b_x", "--on", "unit_c_x")
    added = asked(runs, "add", "wave", first_run, *term, *driven, *file)
    assert added["before"]["error"] > 1.3
    assert added["after"]["error"] == pytest.approx(1.0, abs=0.15)
    (entry,) = yaml.safe_load((tmp_path / "model.yaml").read_text(encoding="utf-8"))["effects"]
    assert (entry["effect"], entry["formula"], entry["units"]) == ("wave", "k*sin(u/w)", {"w": "m/s²"})
    assert entry["channels"] == ["unit_a_x", "unit_b_x", "unit_c_x"]
    assert set(entry["parameters"]) == {"k", "w"}
    assert asked(runs, "fit", first_run, *file)["after"]["error"] == pytest.approx(1.0, abs=0.15)
    assert asked(runs, "diagnose", first_run, *file)["verdict"] == "adequate"


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("wave", "--formula", "k*sin(u/w)"), "wanted starts for it: --start 'w=VALUE UNIT'"),
        (("wave", "--formula", "k*sin(u/w)", "--start", "w=1 s"), "wanted a pure number or an angle"),
        (("wave", "--formula", "k*u**3", "--start", "p=1"), "found a unit or a start for 'p', wanted one of k"),
        (("cubic", "--formula", "k*u**3"), "found the name 'cubic' for a formula.*wanted a name of its own"),
        (("wave", "--formula", "k*u**3", "--on", "unit_a_q"), "--on: found 'unit_a_q', wanted"),
        (("cubic", "--on", "unit_q_x"), "found 'unit_q_x', wanted"),
        (("cubic", "--start", "w=1 g"), "without a formula, wanted --formula with it"),
        (("cubic", "--start", "paperr"), "found 'paperr', wanted datasheet, paper, shared, or"),
    ],
)
def test_a_term_that_cannot_be_added_says_what_would_do(
    runs: Path, first_run: str, words: tuple[str, ...], wanted: str, tmp_path: Path
) -> None:
    effect, *options = words
    with pytest.raises(BadInput, match=wanted) as error:
        said(runs, "add", effect, first_run, *options, "--model", str(tmp_path / "model.yaml"))
    assert error.value.exit_code == 2
    assert not (tmp_path / "model.yaml").exists()


BROKEN = """from rig.model import Array, Coordinate, Effect, Motion, Parameter, Values


class Drag(Effect):
    stage = "transducer"
    title = "drag"
    equation = "u + drag·u⁷"
    quantities = ("acceleration",)
    coordinates = (Coordinate("drag", 1e-9),)
    parameters = (Parameter("drag", "1/(SI)⁶", (-1.0, 1.0), (1e-9, 1e-8)),)
    missing = "it pulls"
    separate_by = "a shorter cable"
    source = "our own bench"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return u + at["drag"] * u**7
"""


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('    title = "drag"', '    title = "drag', 6),
        ('    title = "drag"', "    title = None", 6),
        ('at["drag"]', 'at["drg"]', 16),
        ("u**7", "u[..., :3]**7", 16),
        ('return u + at["drag"] * u**7', "return u.T", 15),
    ],
)
def test_a_mistake_in_an_effect_of_ones_own_is_told_with_file_and_line_and_exit_2(
    runs: Path, first_run: str, old: str, new: str, line: int, tmp_path: Path
) -> None:
    assert old in BROKEN
    (tmp_path / "drag.py").write_text(BROKEN.replace(old, new), encoding="utf-8")
    words = (first_run, "--effects", str(tmp_path), "--model", str(tmp_path / "model.yaml"))
    with pytest.raises(BadInput, match=r"found .*wanted") as error:
        said(runs, "add", "drag", *words)
    assert str(error.value).startswith(f"{tmp_path / 'drag.py'}:{line}:")
    if "drg" in new:  # one of them as a user sees it, where the effect is one of many
        done = rig(runs, "diagnose", *words, wanted=2)
        assert done.stderr.startswith(f"error: {error.value}"[:60])


@pytest.mark.parametrize(
    "words",
    [
        ("diagnose", "nothing"),
        ("add", "cubik", "last"),
        ("remove", "delay", "last"),
        ("history", "--model", "nowhere.yaml"),
        ("add", "own", "last", "--formula", "import os"),
    ],
)
def test_what_cannot_be_used_is_refused(runs: Path, words: tuple[str, ...]) -> None:
    with pytest.raises(BadInput, match=r"found.*wanted"):
        said(runs, *words)


def test_a_notebook_gets_the_same_answers(runs: Path, first_run: str) -> None:
    from rig import Model, open_run

    model = Model(open_run(runs / first_run))
    assert model.diagnose().candidates[0].effect == "cubic"
    model.add("cubic", "acceleration")
    assert [step.action for step in model.history] == ["start", "add"]
    assert model.fit.chi2 / model.fit.count == pytest.approx(1.0, abs=0.3)
    assert model.compare().groups
