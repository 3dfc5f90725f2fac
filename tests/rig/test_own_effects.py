"""A mistake in a user's own effect is a message with file and line, whatever it is and whenever it shows."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rig.errors import BadInput
from rig.motion import Motion, Stretches
from rig.shelf import shelf

RIGHT = '''"""Drag of the cable."""

import numpy as np

from rig.model import Array, Channels, Coordinate, Effect, Motion, Parameter, Values


class Drag(Effect):
    stage = "transducer"
    title = "drag of the cable"
    equation = "u + drag·u²"
    quantities = ("acceleration",)
    coordinates = (Coordinate("drag", 1e-5),)
    parameters = (Parameter("drag", "1/(SI)", (-1.0, 1.0), (1e-4, 1e-2)),)
    missing = "it pulls"
    separate_by = "a shorter cable"
    source = "our own bench"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return u + at["drag"] * u**2
'''
LINE = dict(enumerate(RIGHT.splitlines(), 1))
METHOD = 20
Make = Callable[..., Path]


@pytest.fixture
def folder(tmp_path: Path) -> Make:
    """Writes `drag.py` with one text in place of another; the folder."""

    def write(old: str = "", new: str = "") -> Path:
        assert old in RIGHT
        (tmp_path / "drag.py").write_text(RIGHT.replace(old, new, 1) if old else RIGHT, encoding="utf-8")
        return tmp_path

    return write


def still() -> Motion:
    """Two instants at rest."""
    nothing, up = np.zeros((3, 2)), np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    one = np.ones(2)
    return Motion(Stretches(1e-3, ((0, 2),)), "free", 9.8 * up, nothing, nothing, up, 9.8, 25.0 * one, 5.0 * one, one)


def line_of(text: str) -> int:
    return next(number for number, line in LINE.items() if text in line)


def refused(folder: Path, line: int, said: str) -> None:
    with pytest.raises(BadInput) as error:
        shelf(folder)
    assert str(error.value).startswith(f"{folder / 'drag.py'}:{line}:"), error.value
    assert re.search(said, str(error.value)), error.value
    assert "wanted" in str(error.value)
    assert error.value.exit_code == 2


def test_a_sound_effect_is_on_the_shelf_under_its_files_name(folder: Make) -> None:
    made = shelf(folder())["drag"]
    assert made.name == "drag"
    u = np.array([[1.0, 2.0]])
    assert np.allclose(made.transduce(u, still(), {"drag": 0.1}), [[1.1, 2.4]])


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("class Drag(Effect):", "class Drag(Effect)", "class Drag", r":\d+: found 'class Drag\(Effect\)' \(expected"),
        ("import numpy as np\n", "import numpie as np\n", "import numpy", "found ModuleNotFoundError: No module named"),
        ("Coordinate, Effect", "Koordinate, Effect", "from rig.model", "found ImportError: cannot import name"),
        ('stage = "transducer"', "stage = 1 / 0", "stage =", "found ZeroDivisionError: division by zero"),
        ('stage = "transducer"', 'stage = "sensor"', "stage =", "stage: found 'sensor', wanted one of reference,"),
        ('    stage = "transducer"\n', "", "class Drag", "stage: found nothing"),
        ('missing = "it pulls"', "missing = 3", "missing =", "missing: found 3, wanted a text"),
        ('("acceleration",)', '("force",)', "quantities =", r"quantities: found \('force',\), wanted a tuple of"),
        ('("acceleration",)', '"acceleration"', "quantities =", "quantities: found 'acceleration', wanted a tuple"),
        ('(Coordinate("drag", 1e-5),)', '("drag",)', "coordinates =", r"coordinates: .* wanted a tuple of Coordinate"),
        ('"drag", 1e-5', '"drag", 0.0', "coordinates =", "found the step 0.0 of drag, wanted a number above 0"),
        ('Parameter("drag"', 'Parameter("pull"', "parameters =", "found drag, pull in coordinates or parameters only"),
        ("(-1.0, 1.0)", "(1.0, -1.0)", "parameters =", "wanted two numbers, the lower first"),
        ("def transduce(", "def transduse(", "def transduce", "transduse: found a name that no .*transduce"),
        ("title =", "titel =", "title =", "titel: found a name that no effect has, wanted title"),
    ],
)  # fmt: skip
def test_a_mistake_in_what_it_says_is_told_with_its_line(
    folder: Make, old: str, new: str, line: str, said: str
) -> None:
    refused(folder(old, new), line_of(line), said)


def test_a_file_that_would_end_the_program_is_told_with_its_line(folder: Make) -> None:
    refused(folder("import numpy as np\n", "raise SystemExit(0)\n"), 3, "found SystemExit: 0 while it is loaded")


@pytest.mark.parametrize(
    ("result", "said"),
    [
        ('u + at["drg"] * u**2', r"found KeyError: 'drg' in transduce"),
        ("u + motion.force.nothing", "found AttributeError: .*nothing"),
        ("u[:, [0, 1, 1]]", r"transduce: found an array of shape \(1, 3\), wanted \(1, 2\)"),
        ("np.zeros((2, 2))", r"transduce: found an array of shape \(2, 2\), wanted \(1, 2\)"),
        ("u * np.nan", "transduce: found numbers that are not finite"),
        ("u * 1j", r"transduce: found an array of complex128.*, wanted real numbers"),
        ("'text'", "transduce: found 'text', wanted real numbers"),
        ("None", "transduce: found None, wanted real numbers"),
    ],
)
def test_a_mistake_in_a_method_is_told_with_its_line(folder: Make, result: str, said: str) -> None:
    file = folder('u + at["drag"] * u**2', result)
    made = shelf(file)["drag"]
    with pytest.raises(BadInput, match=said) as error:
        made.transduce(np.array([[1.0, 2.0]]), still(), {"drag": 0.1})
    where = METHOD if "Error" in said else METHOD - 1
    assert str(error.value).startswith(f"{file / 'drag.py'}:{where}:"), error.value
    assert "wanted" in str(error.value)


def test_a_method_with_the_wrong_arguments_is_told_with_its_line(folder: Make) -> None:
    made = shelf(folder("(self, u: Array, motion: Motion, at: Values)", "(self, u: Array)"))["drag"]
    with pytest.raises(BadInput, match=rf"drag.py:{METHOD - 1}: found TypeError: .*in transduce"):
        made.transduce(np.ones((1, 2)), still(), {"drag": 0.1})


def test_the_shipped_effects_pass_the_same_examination(tmp_path: Path) -> None:
    source = Path(__file__).parents[2] / "rig" / "effects"
    for path in source.glob("[a-z]*.py"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert set(shelf(tmp_path)) == set(shelf())
