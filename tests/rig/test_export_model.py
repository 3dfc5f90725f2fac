"""A repaired model in a module without dependencies and in a header for C gives the numbers that the notebook gives."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from rig.cli import cli
from rig.correction.chain import Channel, Undone
from rig.correction.correction import Correction
from rig.correction.inverse import Quantity
from rig.errors import BadInput
from rig.export import write_model
from rig.export.identifiers import identifiers
from rig.formula import formula_effect
from rig.model import Array
from rig.shelf import shelf

RATE = 500.0
COUNT = 300
NAMES = ("α", "β 1", "a b", "a-b", 'rate "x"', "Δ*/ {", "channels")
QUANTITIES: tuple[Quantity, ...] = ("acceleration",) * 3 + ("rate",) * 3 + ("acceleration",)
SENSITIVITY = (0.066, 0.065, -0.067, 0.21, 0.22, 0.2, 0.01)
TERMS: tuple[tuple[str, Quantity | None, dict[str, float]], ...] = (
    ("cubic", "acceleration", {"coefficient": 2e-4}),
    ("asymmetry", "rate", {"ratio": 0.02}),
    ("odd_quadratic", "acceleration", {"coefficient": -1e-3}),
    ("quadratic", "rate", {"coefficient": 0.01}),
    ("temperature_bias", "acceleration", {"coefficient": 0.01}),
    ("temperature_scale", "rate", {"coefficient": 1e-3}),
    ("supply_ratio", "rate", {"share": 1.0}),
    ("warm_up", "acceleration", {"shift": 0.1, "time_constant": 60.0}),
    ("cross_axis", "acceleration", {"share": 0.03}),
    ("non_orthogonality", "acceleration", {"yz": 0.01, "zy": -0.02, "zx": 0.005}),
    ("g_sensitivity", "rate", {"coefficient": 1e-3}),
    ("lever_arm", "acceleration", {"x": 0.01, "y": -0.02, "z": 0.03}),
    ("crosstalk", "rate", {"time_constant": 1e-4}),
    ("delay", "rate", {"time": 7e-3}),
    ("hysteresis", None, {"width": 0.01}),
    ("ldv_delay", None, {"time": 1e-5}),
)


def correction() -> Correction:
    channels = tuple(
        Channel(name, quantity, k % 3, "b" if k == 6 else quantity, sensitivity, 2.5 - 0.01 * k,
                150.0 if k % 2 else None, u_sensitivity=1e-4, u_zero=1e-3)
        for k, (name, quantity, sensitivity) in enumerate(zip(NAMES, QUANTITIES, SENSITIVITY, strict=True))
    )  # fmt: skip
    undone = tuple(Undone(name, on, shelf()[name].inverse(at)) for name, on, at in TERMS)
    formula = "k * sin(wx * t) * sign(wy) + m * abs(T) ** 0.5 - n * y / (1 + exp(-wz * t)) + p * u ** 2"
    own = formula_effect("own", formula, on="acceleration")
    undone += (Undone("own", "acceleration", own.inverse({"k": 0.1, "m": 0.02, "n": 0.03, "p": 1e-3})),)
    return Correction("SIM Cube №1", channels, undone, True, ("Model of */ SIM\nCube \\", 'Fitted to "r1" """'))


def volts() -> Array:
    time = np.arange(COUNT) / RATE
    waves = np.sin(2.0 * math.pi * np.outer(np.arange(1.0, 8.0), time) + np.arange(7.0)[:, None])
    noise = 0.01 * np.random.default_rng(1).standard_normal((7, COUNT))
    return np.asarray(2.5 + np.array(SENSITIVITY)[:, None] * (3.0 * waves + noise))


CONDITIONS: dict[str, Any] = {
    "temperature": list(np.linspace(20.0, 40.0, COUNT)), "supply": 4.95, "time": list(np.arange(COUNT) / RATE),
}  # fmt: skip


def in_python(folder: Path, calls: str) -> Any:
    """What the exported module says, in a Python that has nothing but its own library."""
    (path,) = write_model(correction(), "python", folder, rate=RATE)
    raw = dict(zip(NAMES, volts().tolist(), strict=True))
    program = (
        f"import json, sys; sys.path.insert(0, {str(folder)!r}); import {path.stem} as unit\n"
        f"raw, given = json.loads(sys.stdin.read())\n{calls}\n"
        "assert not {'numpy', 'rig'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-I", "-S", "-c", program], input=json.dumps([raw, CONDITIONS]),
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("rate", [None, RATE])
def test_the_module_gives_the_notebook_s_numbers(rate: float | None, tmp_path: Path) -> None:
    found = in_python(tmp_path, f"print(json.dumps(unit.apply(raw, rate={rate}, **given)))")
    wanted = correction().apply(volts(), rate=rate, **CONDITIONS)
    assert tuple(found) == NAMES
    for name in NAMES:
        np.testing.assert_allclose(found[name], wanted[name], rtol=1e-12, atol=1e-12)


def test_single_samples_and_nominal_conditions_too(tmp_path: Path) -> None:
    found = in_python(tmp_path, "print(json.dumps([unit.apply({n: v[7] for n, v in raw.items()}), "
                                "unit.uncertainty('α', 2.0), unit.NOT_UNDONE, unit.PROVENANCE]))")  # fmt: skip
    wanted = correction().apply(volts()[:, 7])
    np.testing.assert_allclose(list(found[0].values()), wanted.array, rtol=1e-12)
    assert found[1] == pytest.approx(float(correction().chain("α").uncertainty(np.asarray(2.0))))
    assert any(one.startswith("hysteresis: not undone, the output depends") for one in found[2])
    assert found[3]["simulated"] is True
    assert found[3]["notes"][0].startswith("SIMULATED")


def test_the_module_refuses_other_rates_and_channels(tmp_path: Path) -> None:
    calls = (
        "said = []\n"
        "for call in (lambda: unit.apply(raw, rate=100.0), lambda: unit.apply({'α': 1.0}),\n"
        "             lambda: unit.apply(raw, temperature=[1.0])):\n"
        "    try: call()\n"
        "    except ValueError as error: said.append(str(error))\n"
        "print(json.dumps(said))"
    )
    said = in_python(tmp_path, calls)
    assert "wanted records of 500.0 samples per second" in said[0]
    assert "found the channels α, wanted α, β 1" in said[1]
    assert "found 1 values of a condition" in said[2]


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: the header is written but not compiled")
@pytest.mark.parametrize("single", [False, True])
def test_the_header_compiles_without_a_warning_and_gives_the_same_numbers(single: bool, tmp_path: Path) -> None:
    (path,) = write_model(correction(), "c", tmp_path, rate=RATE, single=single)
    still, moving = compiled(tmp_path, path.name, single)
    limit = 2e-4 if single else 1e-6
    wanted = correction().apply(volts(), **CONDITIONS).array
    np.testing.assert_allclose(still, wanted, rtol=limit, atol=limit)
    early = correction_without_rises().apply(volts(), rate=RATE, **CONDITIONS).array
    latency = int(path.read_text("ascii").partition("_LATENCY ")[2].split()[0])
    inner = COUNT - latency - 40  # before the record's end is felt
    np.testing.assert_allclose(moving[:, latency : latency + inner], early[:, :inner], rtol=limit, atol=limit)


def correction_without_rises() -> Correction:
    """The header's filters know no derivatives: what they add stays."""
    whole = correction()
    one = shelf()["lever_arm"].inverse(TERMS[11][2])
    kept = tuple(replace(u, inverse=replace(one, turning=np.zeros((3, 3)))) if u.name == "lever_arm" else u
                 for u in whole.undone if u.name != "crosstalk")  # fmt: skip
    return replace(whole, undone=kept)


def compiled(folder: Path, header: str, single: bool) -> tuple[Array, Array]:
    """Every sample through `apply` and through `step`, (channels, samples)."""
    real, stem = "float" if single else "double", header.removesuffix("_correction.h")
    program = f"""
#include <stdio.h>
#include "{header}"
static {stem}_filter filter;
int main(void) {{
    {real} in[{stem.upper()}_CHANNELS], still[{stem.upper()}_CHANNELS], moving[{stem.upper()}_CHANNELS];
    double v, t, s, e;
    int n;
    for (;;) {{
        if (scanf("%lf %lf %lf", &t, &s, &e) != 3) return 0;
        for (n = 0; n < {stem.upper()}_CHANNELS; ++n) {{ if (scanf("%lf", &v) != 1) return 1; in[n] = ({real})v; }}
        {stem}_apply(in, ({real})t, ({real})s, ({real})e, still);
        {stem}_step(&filter, in, ({real})t, ({real})s, ({real})e, moving);
        for (n = 0; n < {stem.upper()}_CHANNELS; ++n) printf("%.17g ", (double)still[n]);
        for (n = 0; n < {stem.upper()}_CHANNELS; ++n) printf("%.17g ", (double)moving[n]);
        printf("\\n");
    }}
}}
"""
    (folder / "main.c").write_text(program, encoding="ascii")
    subprocess.run(
        ["gcc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "main.c", "-o", "main", "-lm"],
        cwd=folder, check=True,
    )  # fmt: skip
    table = np.column_stack(
        [CONDITIONS["temperature"], np.full(COUNT, CONDITIONS["supply"]), CONDITIONS["time"], volts().T]
    )
    text = "\n".join(" ".join(repr(float(v)) for v in row) for row in table)
    done = subprocess.run([str(folder / "main")], input=text, capture_output=True, text=True, check=True)
    rows = np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])
    return rows[:, :7].T, rows[:, 7:].T


def test_a_header_without_a_rate_has_no_filter_and_says_how_late_channels_are(tmp_path: Path) -> None:
    (path,) = write_model(correction(), "c", tmp_path)
    text = path.read_text("ascii")
    assert path.name == "sim_cube_no1_correction.h"
    assert "_step(" not in text
    assert "SIMULATED: made on the simulated bench" in text
    assert "filters and delays: not undone without a rate" in text
    assert "hysteresis: not undone" in text
    assert "SIM_CUBE_NO1_CHANNELS_2 = 6" in text  # a channel of that name does not take the count's


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"format": "csv"}, "found 'csv', wanted --to python or c"),
        ({"format": "python", "single": True}, "wanted --to c"),
        ({"format": "c", "rate": -1.0}, "found -1.0, wanted samples per second"),
    ],
)
def test_what_cannot_be_written_is_refused_and_no_file_appears(
    options: dict[str, Any], found: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInput) as refused:
        write_model(correction(), folder=tmp_path / "out", **options)
    assert found in str(refused.value)
    assert not (tmp_path / "out").exists()


@given(st.lists(st.text(max_size=8), max_size=12))
def test_names_become_identifiers_that_are_never_alike(names: list[str]) -> None:
    found = identifiers(names, ["RATE"])
    assert list(found) == list(dict.fromkeys(names))
    assert all(("x" + one).isidentifier() and one.isascii() for one in found.values())
    assert len({one.upper() for one in found.values()} | {"RATE"}) == len(found) + 1


def test_greek_letters_are_spelled_and_doubles_are_numbered() -> None:
    found = identifiers(["α 1", "Α-1", "a b", "a_b", "ω̇", "ускорение"])
    assert list(found.values())[:5] == ["alpha_1", "Alpha_1_2", "a_b", "a_b_2", "omega"]


MODEL = """format: 1
unit: U 1
effects:
- {effect: cubic, on: acceleration, coordinates: {coefficient: {value: 0.0002}}}
- {effect: own_bend, on: acceleration, coordinates: {size: {value: 0.01}}}
- {effect: own_other, on: acceleration, coordinates: {size: {value: 0.01}}}
- {effect: term, formula: k * u**2, on: acceleration, coordinates: {k: {value: 0.001}}}
- {effect: far, formula: k * A, on: acceleration, coordinates: {k: {value: 0.001}}}
channels:
  up: {sensitivity: {value: 0.1, unit: V/(m/s²), u: 0.001}, zero: {r: 2.5}, u_zero: {r: 0.01}, axis: z, triad: t}
  turn: {sensitivity: {value: 0.2, unit: V/(rad/s)}, zero: {r: 2.4}, axis: z, triad: t}
"""
OWN = '''"""An effect of one's own."""
from rig.model import Bend, Coordinate, Effect, Inverse, Parameter, Values

class Own(Effect):
    stage = "transducer"
    title = equation = missing = separate_by = source = "own"
    quantities = ("acceleration",)
    coordinates = (Coordinate("size", 0.01),)
    parameters = (Parameter("size", "1", (-1.0, 1.0), (0.0, 1.0)),)
'''
INVERSE = """
    def inverse(self, at: Values) -> Inverse:
        return Bend(relative=at["size"])
"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A model written by hand, with effects of a user's own folder."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "own_bend.py").write_text(OWN + INVERSE, encoding="utf-8")
    (tmp_path / "own" / "own_other.py").write_text(OWN, encoding="utf-8")
    (tmp_path / "model.yaml").write_text(MODEL, encoding="utf-8")
    return tmp_path / "model.yaml"


def exported(*words: str) -> str:
    return CliRunner().invoke(cli, ["export", *words], catch_exceptions=False, standalone_mode=False).stdout


def test_the_command_writes_a_model_and_says_what_stays(model: Path) -> None:
    words = ["--model", str(model), "--effects", str(model.parent / "own"), "--out", str(model.parent / "out")]
    said = json.loads(exported(*words, "--to", "python", "--json"))
    assert said["files"] == [str(model.parent / "out" / "u_1_correction.py")]
    assert "own_other: not undone, its file does not say how" in said["not_undone"]
    assert "far: not undone, a robot does not know A, which only the bench has" in said["not_undone"]
    assert not any(one.startswith("own_bend") for one in said["not_undone"])
    module: dict[str, Any] = {}
    exec(compile(Path(said["files"][0]).read_text("utf-8"), "u_1_correction.py", "exec"), module)
    u = 3.0
    felt = u + 1e-3 * u**2
    shown = 2.5 + 0.1 * 1.01 * (felt + 2e-4 * felt**3)
    assert module["apply"]({"up": shown, "turn": 2.8})["up"] == pytest.approx(u, rel=1e-12)
    some = exported(*words, "--to", "c", "--channel", "up", "--single")
    assert "c: " in some
    assert "--channel up" in some
    text = (model.parent / "out" / "u_1_correction.h").read_text("ascii")
    assert "U_1_UP = 0" in text
    assert "U_1_TURN" not in text


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["--to", "python"], "found neither a calibration nor --model"),
        (["--to", "c"], "found no model, wanted --model FILE"),
        (["--to", "csv", "--model", "{model}"], "wanted --to python or c"),
        (["--to", "c", "--model", "{model}", "--channel", "left"], "found 'left', wanted some of up, turn"),
        (["--to", "c", "--model", "{model}x"], "found no model"),
    ],
)
def test_the_command_refuses_what_makes_no_model(words: list[str], found: str, model: Path) -> None:
    given = [word.replace("{model}", str(model)) for word in words]
    with pytest.raises(BadInput) as refused:
        exported(*given, "--effects", str(model.parent / "own"), "--out", str(model.parent / "out"))
    assert found in str(refused.value)
