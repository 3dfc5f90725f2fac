"""Infinities, gaps and marks among foreign numbers: nothing warns, and what can be shown is shown."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import foreign_data as made
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from rig.cli import cli
from rig.errors import BadInput

Array = NDArray[np.float64]
RECORDS: Mapping[str, tuple[Callable[[], dict[str, Array]], str]] = {
    "static": (made.resting, made.resting_manifest("d.csv")),
    "rotation": (lambda: made.turning(seconds=20.0), made.turning_manifest("d.csv")),
    "sweep": (made.shaken, made.shaken_manifest("d.csv")),
    "motion": (made.tracked, made.tracked_manifest("d.csv")),
    "response": (made.responding, made.responding_manifest("d.csv")),
}
ODD: Mapping[str, Callable[[Array], None]] = {
    "infinities": lambda values: np.put(values, [2, 5, 6], [np.inf, -np.inf, np.inf]),
    "one NaN": lambda values: np.put(values, [4], np.nan),
    "no number": lambda values: values.fill(np.nan),
    "infinite": lambda values: values.fill(np.inf),
    "the largest float": lambda values: np.put(values, [3], np.finfo(np.float64).max),
}


def said(*words: object, refused: bool = False) -> str:
    """What a command prints; a warning is an error, and a refusal one only where none is expected."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = CliRunner().invoke(cli, [str(word) for word in words], standalone_mode=False)
    if done.exception is not None and not (refused and isinstance(done.exception, BadInput)):
        raise done.exception
    return done.output


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("kind", RECORDS)
def test_nothing_warns_and_the_run_is_shown(tmp_path: Path, kind: str, odd: str) -> None:
    whole, text = RECORDS[kind]
    data, runs = whole(), tmp_path / "runs"
    name = list(data)[-1]
    ODD[odd](data[name])
    (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
    (tmp_path / "m.yaml").write_text(text, encoding="utf-8")
    said("import", "--guess", tmp_path / "d.csv")
    assert f"{name}: " in said("import", tmp_path / "m.yaml", "--runs", runs)
    assert "are not numbers" in said("show", "last", "--runs", runs)
    if kind != "static":
        said("compare", "last", "--runs", runs, refused=True)


@pytest.mark.parametrize(
    ("form", "written"), [("npz", made.npz_bytes), ("mat", made.mat_bytes), ("hdf5", made.hdf5_bytes)]
)
def test_infinities_in_array_files_are_no_numbers_either(
    tmp_path: Path, form: str, written: Callable[[Mapping[str, Array]], bytes]
) -> None:
    data = made.resting()
    ODD["infinities"](data["acc_x_g"])
    path = tmp_path / f"d.{form}"
    path.write_bytes(written(data))
    inside = "imu/" if form == "hdf5" else ""
    text = made.resting_manifest(path.name).replace("{column: ", f"{{column: {inside}")
    (tmp_path / "m.yaml").write_text(text, encoding="utf-8")
    said("import", "--guess", path)
    assert f"{inside}acc_x_g: 3 of 2000 rows are not numbers" in said("import", tmp_path / "m.yaml", "--runs", tmp_path)


def test_noise_is_stated_for_the_channels_that_are_whole_and_refused_for_the_other(tmp_path: Path) -> None:
    data = made.resting()
    data["acc_y_g"][70] = np.nan
    (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
    (tmp_path / "m.yaml").write_text(made.resting_manifest("d.csv"), encoding="utf-8")
    said("import", tmp_path / "m.yaml", "--runs", tmp_path / "runs")
    lines = said("show", "last", "--runs", tmp_path / "runs").splitlines()
    noises = {line.split(", ")[1].split(":")[0]: line for line in lines if line.startswith("  d, ")}
    assert "no noise, found 1 rows without a number" in noises.pop("acc_y_g")
    assert len(noises) == 5
    assert all("N = " in line for line in noises.values())
