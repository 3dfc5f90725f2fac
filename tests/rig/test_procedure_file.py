"""Procedure files: one procedure or a sequence; repetitions, prompts, waits; mistakes at their lines."""

from __future__ import annotations

from typing import Any

import pytest
from jsonschema import Draft202012Validator

from rig.bench import procedure_file
from rig.bench.benchfile import describe
from rig.bench.steps import Ask, Plan, Sine, Static, Wait
from rig.errors import ConfigError
from rig.yaml import config
from rig.yaml.config import shipped
from rig.yaml.document import read_text

FACTS = describe(shipped("benches/simulated.yaml")).facts()


def plan(text: str) -> Plan:
    return procedure_file.plan(read_text(text, "mine.yaml"), FACTS)


def mistakes(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        plan(text)
    return str(caught.value).splitlines()


def test_procedures_are_found_by_the_names_of_their_files() -> None:
    assert set(procedure_file.procedures()) == {"frequency_sweep", "noise", "tumble", "turntable"}


@pytest.mark.parametrize("name", ["frequency_sweep", "noise", "tumble", "turntable"])
def test_a_file_with_only_a_procedure_name_is_that_procedure_with_its_defaults(name: str) -> None:
    made = plan(f"procedure: {name}\n")
    assert made.procedure == name
    assert made.title
    assert made.steps


def test_a_sequence_does_its_items_in_order() -> None:
    made = plan(
        "title: three things\nsteps:\n  - prompt: Is it warm?\n  - wait: 90 s\n  - {procedure: noise, length: 3 s}\n"
    )
    assert (made.procedure, made.title) == ("sequence", "three things")
    prompt, wait, cables, record = made.steps
    assert isinstance(prompt, Ask)
    assert (prompt.request.action, prompt.request.text) == ("confirm", "Is it warm?")
    assert isinstance(wait, Wait)
    assert wait.duration == 90.0
    assert isinstance(cables, Ask)
    assert isinstance(record, Static)
    assert made.points == 1


def test_a_repetition_asks_for_a_remount_between_turns_and_never_before_the_first() -> None:
    made = plan("steps:\n  - repeat: 3\n    steps:\n      - {procedure: noise, length: 2 s}\n")
    actions = [step.request.action if isinstance(step, Ask) else "record" for step in made.steps]
    assert actions == ["cables", "record", "remount", "cables", "record", "remount", "cables", "record"]
    assert made.points == 3


def test_settings_of_a_sequence_are_on_record_as_they_were_written() -> None:
    made = plan("steps:\n  - wait: 1 s\n  - repeat: 2\n    steps: [{procedure: noise, length: 2 s}]\n")
    settings: Any = made.settings
    assert settings["steps"][1]["repeat"] == 2
    assert settings["steps"][1]["steps"][0]["length"] == "2.0 s"


def test_expectations_of_a_sweep_inside_a_sequence_are_kept() -> None:
    made = plan(
        "steps:\n  - procedure: frequency_sweep\n    points: 1\n"
        "    expect: {sensitivity: {within: [630 mV/g, 670 mV/g]}}\n"
    )
    assert made.expect["unit_a_x.sensitivity"] == pytest.approx((0.63 / 9.80665, 0.67 / 9.80665))


def test_the_same_file_gives_the_same_steps_every_time() -> None:
    text = "procedure: frequency_sweep\nseed: 9\n"
    assert plan(text).steps == plan(text).steps
    assert any(isinstance(step, Sine) for step in plan(text).steps)


def test_nested_mistakes_of_type_stand_at_their_own_line_and_key() -> None:
    lines = mistakes(
        "steps:\n  - {procedure: noise, lenght: 3 s}\n  - repeat: two\n    steps:\n      - wait: 3\n"
        "      - {procedure: turntable, axis: x}\n"
    )
    assert [line.split(": ")[0] for line in lines] == [
        "mine.yaml:2:24 steps[0].lenght",
        "mine.yaml:3:13 steps[1].repeat",
        "mine.yaml:5:15 steps[1].steps[0].wait",
        "mine.yaml:6:38 steps[1].steps[1].axis",
    ]
    assert "did you mean 'length'?" in lines[0]


def test_nested_mistakes_of_sense_stand_at_their_own_line_and_key() -> None:
    lines = mistakes(
        "steps:\n  - {procedure: noise, length: 3 s}\n  - repeat: 1\n    steps:\n"
        "      - procedure: frequency_sweep\n        stop: 10 Hz\n"
    )
    assert lines == ["mine.yaml:6:15 steps[1].steps[0].stop: found 10 Hz, wanted more than start (20 Hz)"]


def test_a_mistake_inside_a_repetition_is_told_once() -> None:
    lines = mistakes("steps:\n  - repeat: 5\n    steps:\n      - {procedure: noise, length: 0 s}\n")
    assert lines == ["mine.yaml:4:36 steps[0].steps[0].length: found 0 s, wanted 1 s to 48 h"]


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("procedure: dance\n", "mine.yaml:1:12 procedure: found 'dance', wanted "),
        ("steps:\n  - {procedure: dance}\n", "mine.yaml:2:17 steps[0].procedure: found 'dance', wanted "),
    ],
)
def test_an_unknown_procedure_is_named_with_those_that_there_are(text: str, start: str) -> None:
    (line,) = mistakes(text)
    assert line.startswith(start)
    assert all(name in line for name in ("frequency_sweep", "noise", "tumble", "turntable"))


def test_an_item_that_says_nothing_of_its_kind_is_told_what_it_may_be() -> None:
    (line,) = mistakes("steps:\n  - {axis: x}\n")
    assert line.startswith("mine.yaml:2:5 steps[0]")
    assert "_kind" not in line
    assert "procedure" in line


def test_the_schema_says_what_the_reader_says() -> None:
    validator = Draft202012Validator(config.json_schema(procedure_file.file_model()))
    good = {"steps": [{"repeat": 2, "steps": [{"procedure": "noise", "length": "3 s"}]}, {"wait": "1 s"}]}
    assert validator.is_valid(good)
    assert not validator.is_valid({"steps": [{"procedure": "noise", "lenght": "3 s"}]})
    assert not validator.is_valid({"procedure": "dance"})
