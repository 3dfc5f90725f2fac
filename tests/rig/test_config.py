"""YAML into typed values: every mistake is named by file, line, column, key, what was found and what was wanted."""

from __future__ import annotations

import datetime as dt
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from pydantic import BaseModel, ConfigDict, Field, RootModel, field_validator

from rig.archive import journal
from rig.errors import BadInput, ConfigError, Problem, WorkFailed
from rig.units import Frequency, Length, Time
from rig.yaml import config, document

ROOT = Path(__file__).parents[2]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Dwell(Strict):
    kind: Literal["dwell"]
    seconds: Time


class Spin(Strict):
    kind: Literal["spin"]
    speeds: list[float]
    radius: Length = Field(default=0.05, gt=0, le=0.14)


class Sequence(Strict):
    title: str = ""
    points: int = Field(default=24, ge=1)
    stop: Frequency = 500.0
    axis: Literal["x", "y", "z"] = "x"
    all: bool = False
    pair: tuple[float, float] | None = None
    due: dt.date | None = None
    steps: list[Annotated[Dwell | Spin, Field(discriminator="kind")]] = []
    named: dict[str, Dwell] = {}
    mixed: int | bool | None = None

    @field_validator("title")
    @classmethod
    def _no_shouting(cls, title: str) -> str:
        if title.isupper():
            raise ValueError("it shouts")
        return title


def mistakes(text: str, model: type[BaseModel] = Sequence) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        config.validate(config.read_text(text, "a.yaml"), model)
    return [str(problem) for problem in caught.value.problems]


def test_what_a_journal_holds_is_written_as_the_yaml_that_it_was() -> None:
    body = {"procedure": "sequence", "steps": [{"stop": "1 kHz", "levels": ["full"]}], "title": "µ"}
    raw, _ = journal.line(0, 0.0, 0.0, "header", {"document": body}, journal.GENESIS)
    kept = journal.read_line(raw, journal.GENESIS, 0).body["document"]
    assert config.read_text(document.written(kept), "a.yaml").data == body


def test_a_file_that_would_take_minutes_to_read_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("steps:\n" + "  - {kind: dwell, seconds: 3 s}\n" * 400_000)
    with pytest.raises(ConfigError, match=r"found 12\.8 MB, wanted a file of at most 0\.5 MB"):
        config.load(path, Sequence)


def test_a_file_becomes_a_model(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(
        "\ufefftitle: no\npoints: 12\nstop: 1 kHz\npair: [1, 2.5]\ndue: 2026-11-24\n"
        "steps:\n  - {kind: dwell, seconds: 3 s}\nnamed:\n  a: {kind: dwell, seconds: 1 s}\n"
    )
    settings = config.load(path, Sequence)
    assert (settings.title, settings.points, settings.stop) == ("no", 12, 1000.0)
    assert settings.pair == (1.0, 2.5)
    assert settings.due == dt.date(2026, 11, 24)
    assert settings.steps == [Dwell(kind="dwell", seconds="3 s")]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("stop: 500\n", "a.yaml:1:7 stop: found '500', wanted a frequency such as '500 Hz'"),
        ("points: 24.5\n", "a.yaml:1:9 points: found '24.5', wanted a whole number"),
        ("points: '24'\n", "a.yaml:1:9 points: found '24', wanted a whole number"),
        ("points: true\n", "a.yaml:1:9 points: found 'true', wanted a whole number"),
        ("points: 0\n", "a.yaml:1:9 points: found '0', wanted at least 1"),
        ("points:\n", "a.yaml:1:8 points: found nothing, wanted a whole number"),
        ("all: yes\n", "a.yaml:1:6 all: found 'yes', wanted true or false"),
        ("title: 12\n", "a.yaml:1:8 title: found '12', wanted text (in quotes, if it looks like something else)"),
        ("title: [a]\n", "a.yaml:1:8 title: found a list, wanted text (in quotes, if it looks like something else)"),
        ("title: LOUD\n", "a.yaml:1:8 title: found 'LOUD', wanted another value (it shouts)"),
        ("axis: w\n", "a.yaml:1:7 axis: found 'w', wanted 'x', 'y' or 'z'"),
        ("pair: [1]\n", "a.yaml:1:7 pair[1]: found nothing, wanted one more item"),
        ("pair: 1\n", "a.yaml:1:7 pair: found '1', wanted a list"),
        ("due: 24.11.2026\n", "a.yaml:1:6 due: found '24.11.2026', wanted a date such as 2026-01-31"),
        ("mixed: [1]\n", "a.yaml:1:8 mixed: found a list, wanted a whole number or true or false"),
        ("steps: {a: 1}\n", "a.yaml:1:8 steps: found a mapping of keys, wanted a list"),
        ("steps:\n  - kind: dwel\n", "a.yaml:2:11 steps[0].kind: found 'dwel', wanted 'dwell' or 'spin'"),
        ("steps:\n  - seconds: 1 s\n", "a.yaml:2:5 steps[0].kind: found nothing, wanted 'dwell' or 'spin'"),
        ("steps:\n  - kind: dwell\n", "a.yaml:2:5 steps[0].seconds: found nothing, wanted a time such as '300 ms'"),
        ("named: {a: {kind: dwell, seconds: 3}}\n", "a.yaml:1:35 named.a.seconds: found '3', wanted a time such as '300 ms'"),  # noqa: E501
        (
            "steps: [{kind: spin, speeds: [45, fast]}]\n",
            "a.yaml:1:35 steps[0].speeds[1]: found 'fast', wanted a number",
        ),
        (
            "steps: [{kind: spin, speeds: [], radius: 20 cm}]\n",
            "a.yaml:1:42 steps[0].radius: found '20 cm', wanted at most 140 mm",
        ),
        (
            "steps:\n  - kind: dwell\n    seconds: 1 s\n    secnds: 2 s\n",
            "a.yaml:4:5 steps[0].secnds: found an unknown key, wanted one of kind, seconds (did you mean 'seconds'?)",
        ),
        ("- 1\n", "a.yaml:1:1 found a list, wanted a mapping of keys"),
        ("hello\n", "a.yaml:1:1 found 'hello', wanted a mapping of keys"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_named_with_its_place(text: str, expected: str) -> None:
    assert mistakes(text) == [expected]


def test_an_unknown_key_lists_the_keys_there_are() -> None:
    (found,) = mistakes("zzz: 1\n")
    assert found.startswith("a.yaml:1:1 zzz: found an unknown key, wanted one of all, axis, due, ")
    assert "did you mean" not in found


def test_all_mistakes_are_told_at_once_in_the_order_of_the_file() -> None:
    found = mistakes("axis: w\nsteps:\n  - {kind: spin}\nstop: 5\nponts: 3\n")
    assert [row.split(" ")[0] for row in found] == ["a.yaml:1:7", "a.yaml:3:5", "a.yaml:4:7", "a.yaml:5:1"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: 1\na: 2\n", "a.yaml:2:1 a: found the key twice (first in line 1), wanted it once"),
        ("s:\n  - {b: 1, b: 2}\n", "a.yaml:2:12 s[0].b: found the key twice (first in line 2), wanted it once"),
        ("a:\n\t- b\n", "a.yaml:2:1 found a tab, wanted spaces"),
        ("a: &x 1\nb: *x\n", "a.yaml:1:4 found an anchor or alias, wanted the value written out"),
        ("*x\n", "a.yaml:1:1 found an anchor or alias, wanted the value written out"),
        ("&a [*a]\n", "a.yaml:1:1 found an anchor or alias, wanted the value written out"),
        ("a: !!int x\n", "a.yaml:1:4 found the tag 'tag:yaml.org,2002:int', wanted a plain value"),
        ("a: !!python/name:os.system\n", None),
        ("a: \x00b\n", "a.yaml:1:4 found the character U+0000, wanted printable text"),
        ("b: 1\na: \x07\n", "a.yaml:2:4 found the character U+0007, wanted printable text"),
        ("", "a.yaml:1:1 found an empty document, wanted keys and values"),
        ("# only this\n", "a.yaml:1:1 found an empty document, wanted keys and values"),
        ("a: 1\n---\nb: 2\n", "a.yaml:2:1 found a second document, wanted one"),
        ("a: b: c\n", "a.yaml:1:5 found a second ':' on one line, wanted quotes around the text, or a new line"),
        ("a: [1, 2\nb: 3\n", "a.yaml:2:2 found ':', wanted ',' or ']'"),
        ("a: 1e999\n", "a.yaml:1:4 a: found '1e999', wanted a number that a computer can hold"),
        ("a: " + "9" * 5000, "a.yaml:1:4 a: found a number of 5000 characters, wanted at most 30"),
        ('a: "\\ud800"\n', "a.yaml:1:4 a: found half a character, wanted text"),
        ("? [a]\n: b\n", "a.yaml:1:3 found a list as a key, wanted plain text"),
        ("[" * 200, "a.yaml:1:51 found more than 50 levels, wanted a flatter file"),
        ('a: "\\UFFFFFFFF"\n', None),
        ("a: @b\n", None),
    ],
)
def test_what_is_not_plain_yaml_is_refused_where_it_stands(text: str, expected: str | None) -> None:
    found = mistakes(text)
    assert all(re.match(r"a\.yaml:\d+:\d+ .*found .+, wanted ", row) for row in found)
    if expected is not None:
        assert found == [expected]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("no", "no"), ("on", "on"), ("true", True), ("12:30", "12:30"), ("1e-3", 0.001), ("010", "010"), ("0x1F", 31),
        ("~", None), ("", None), ("2026-01-19", "2026-01-19"), ("'1'", "1"), (".5", 0.5), ("-3", -3),
        ("1_000", "1_000"), ("NaN", "NaN"), (".inf", ".inf"),
    ],
)  # fmt: skip
def test_scalars_mean_what_they_look_like(text: str, value: object) -> None:
    assert config.read_text(f"a: {text}\n", "a.yaml").data == {"a": value}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"a: 1\nb: \xff\n", ":2:4 found byte 0xff, wanted text in UTF-8"),
        (b"\xef\xbb\xbfa: \xff\n", ":1:4 found byte 0xff, wanted text in UTF-8"),
    ],
)
def test_a_byte_that_is_no_text_is_named_with_its_place(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        config.read(path)
    assert str(caught.value) == f"{path}{expected}"


def test_a_file_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    for path, words in (
        (tmp_path / "none.yaml", "found no such file"),
        (tmp_path, "found a folder"),
        (tmp_path / "a\0b", "cannot be read"),
        (tmp_path / ("x" * 300), "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=words):
            config.load_mapping(path)


def assert_clear(read: Callable[[], object]) -> None:
    """It works, or says what is wrong and where."""
    problems: tuple[Problem, ...] = ()
    try:
        read()
    except ConfigError as error:
        problems = error.problems
    assert all("found " in p.text and ", wanted " in p.text and p.line > 0 and p.column > 0 for p in problems)


@given(st.binary(max_size=200))
def test_no_bytes_make_it_raise_anything_but_a_config_error(
    tmp_path_factory: pytest.TempPathFactory, raw: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.yaml"
    path.write_bytes(raw)
    assert_clear(lambda: config.load(path, Sequence))


FRAGMENTS = st.lists(
    st.sampled_from(
        ["steps:", "- ", "  ", "\n",
         "kind: ", "dwell", "spin", "{", "}", "[", "]", ": ", ", ", "'", '"', "\\U", "!!int ",
         "&a ", "*a", "%YAML 9", "---", "...", "|", ">", "? ", "#", "\t", "\x00", "1e9", "0x", "~", "<<: ", "speeds: ",
         "points: ", "é", "\ud800", "stop: ", "5 Hz", "title: ", "named: ", "@", "`", "\r"]
    ),
    max_size=25,
)  # fmt: skip


@given(FRAGMENTS)
def test_no_text_makes_it_raise_anything_but_a_config_error(parts: list[str]) -> None:
    assert_clear(lambda: config.validate(config.read_text("".join(parts), "a.yaml"), Sequence))


def test_later_checks_find_their_key() -> None:
    document = config.read_text("title: t\nsteps:\n  - kind: spin\n    speeds: [33, 45]\n", "a.yaml")
    assert config.locate(document, ("steps", 0, "speeds", 1)) == (4, 18)
    assert config.locate(document, ("steps", 0, "radius")) == (3, 5)
    assert config.locate(document, ("steps", 7, "radius")) == (3, 3)
    assert config.locate(document, ()) == (1, 1)
    problem = document.problem(("steps", 0, "speeds", 1), "found 45, wanted 78")
    assert str(problem) == "a.yaml:4:18 steps[0].speeds[1]: found 45, wanted 78"


def test_a_part_of_a_file_is_checked_with_places_in_the_whole() -> None:
    document = config.read_text("steps:\n  - {kind: dwell, seconds: 1 s}\n  - {kind: dwell, seconds: 2}\n", "a.yaml")
    assert config.check(document, Dwell, ("steps", 0)) == (Dwell(kind="dwell", seconds="1 s"), [])
    value, problems = config.check(document, Dwell, ("steps", 1))
    assert value is None
    assert problems == [Problem("a.yaml", 3, 28, "steps[1].seconds", "found '2', wanted a time such as '300 ms'")]


class Answers(RootModel[list[Dwell]]):
    pass


def test_a_list_at_the_top_is_checked_too() -> None:
    document = config.read_text("- {kind: dwell, seconds: 1 s}\n", "a.yaml")
    assert config.validate(document, Answers).root[0].seconds == 1.0
    (found,) = mistakes("- {kind: dwell, second: 1 s, seconds: 1 s}\n", Answers)
    assert (
        found == "a.yaml:1:17 [0].second: found an unknown key, wanted one of kind, seconds (did you mean 'seconds'?)"
    )


def test_the_schema_has_defaults_as_a_file_would_write_them_and_accepts_what_the_program_accepts() -> None:
    schema = config.json_schema(Sequence)
    assert schema["properties"]["stop"]["default"] == "500 Hz"
    Draft202012Validator.check_schema(schema)
    checker = Draft202012Validator(schema)
    assert checker.is_valid({"stop": "33 1/3 Hz", "steps": [{"kind": "dwell", "seconds": "1 µs"}]})
    assert not checker.is_valid({"stop": 500})
    assert not checker.is_valid({"stopp": "500 Hz"})


@pytest.mark.parametrize("path", sorted((ROOT / "configs").rglob("*.yaml")), ids=lambda path: path.name)
def test_every_shipped_config_is_plain_yaml(path: Path) -> None:
    assert config.load_mapping(path)


def test_shipped_files_are_found_beside_the_package_in_a_checkout() -> None:
    assert config.shipped("benches/simulated.yaml") == ROOT / "configs/benches/simulated.yaml"
    with pytest.raises(BadInput, match="found no configs/nowhere"):
        config.shipped("nowhere")


def test_shipped_files_are_found_inside_the_package_when_installed(tmp_path: Path) -> None:
    package = tmp_path / "site-packages" / "rig"
    (package / "configs" / "benches").mkdir(parents=True)
    (package / "configs" / "benches" / "simulated.yaml").write_text("a: 1\n")
    (package.parent / "configs").mkdir()  # of some other program
    (package / "requirements-run.lock").write_text("numpy==2\n")
    assert config.shipped("benches/simulated.yaml", package) == package / "configs/benches/simulated.yaml"
    assert config.program_version(package)["lock_sha256"] == hashlib.sha256(b"numpy==2\n").hexdigest()


def test_the_program_says_which_version_and_which_dependencies_it_is(tmp_path: Path) -> None:
    found = config.program_version()
    assert found["lock_sha256"] == hashlib.sha256((ROOT / "requirements-run.lock").read_bytes()).hexdigest()
    assert found["version"]
    with pytest.raises(WorkFailed, match=r"requirements-run\.lock"):
        config.program_version(tmp_path / "rig")
