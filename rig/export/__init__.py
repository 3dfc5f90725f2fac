"""Calibrations in the files that robots, spreadsheets and other programs load.

    write(calibration, "kalibr", Path("out"), rate=200.0, assumed={"gyroscope_random_walk": 1e-5})

A format makes all its files in memory first, and each file then appears whole or not at all. What a format needs and
the calibration does not hold is refused with the record that would determine it; nothing is made up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from rig.archive.durable import keeping, write_whole
from rig.calibrate.calibration import Calibration, path_of
from rig.correction.correction import Correction
from rig.errors import BadInput
from rig.export import c_header, hdf5, kalibr, matlab, model_module, python_module, ros2, table
from rig.export.selection import Choice, chosen

Files = Mapping[str, bytes]


@dataclass(frozen=True)
class Format:
    """One kind of file: `files` turns a calibration into contents by suffix, `suffixes` are all it makes."""

    files: Callable[[Calibration, Choice], Files]
    suffixes: tuple[str, ...]
    title: str


FORMATS: Mapping[str, Format] = MappingProxyType(
    {
        "kalibr": Format(kalibr.files, (".imu.yaml",), "noise parameters for Kalibr"),
        "ros2": Format(ros2.files, (".ros2.yaml",), "parameters of a ROS 2 driver node"),
        "csv": Format(table.files, (".results.csv", ".responses.csv"), "tables for a spreadsheet"),
        "mat": Format(matlab.files, (".mat",), "MAT-file, version 5"),
        "hdf5": Format(hdf5.files, (".h5",), "HDF5 with units and covariance"),
        "python": Format(python_module.files, ("_calibration.py",), "a module that applies the calibration"),
    }
)

MODEL_FORMATS = ("python", "c")


def write(
    calibration: Calibration,
    format: str,
    folder: Path,
    *,
    unit: str | None = None,
    gyros: str | None = None,
    rate: float | None = None,
    topic: str = "/imu0",
    assumed: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write one format into `folder` and return the files; `rate` (Hz), `topic` and `assumed` are Kalibr's.

    `unit` names the accelerometers and `gyros` the gyros as the sensor file calls their units; without a name the
    primary ones and the first ones.

    Raises BadInput for an unknown format, unit or set of gyros, and for a quantity that the format needs and the
    calibration does not have; ArchiveError if a file cannot be kept. Nothing is written then.
    """
    if format not in FORMATS:
        raise BadInput(f"export --to: found '{format}', wanted one of {', '.join(FORMATS)}")
    triads = chosen(calibration, "acceleration", unit), chosen(calibration, "rate", gyros)
    choice = Choice(*triads, rate, topic, dict(assumed or {}))
    contents = FORMATS[format].files(calibration, choice)
    stem = _stem(calibration, format)
    with keeping(folder):
        folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{stem}{suffix}" for suffix in contents]
    for path, data in zip(paths, contents.values(), strict=True):
        write_whole(path, data)
    return paths


def write_model(
    correction: Correction, format: str, folder: Path, *, rate: float | None = None, single: bool = False
) -> list[Path]:
    """Write a repaired model, turned round, as a Python module or a header in C, and return the files.

    `rate`: samples per second at which filters and delays are to be undone. `single`: floats in C instead of doubles.
    Raises BadInput for another format, and ArchiveError if a file cannot be kept. Nothing is written then.
    """
    if format not in MODEL_FORMATS:
        raise BadInput(f"export --model: found '{format}', wanted --to {' or '.join(MODEL_FORMATS)}")
    if single and format != "c":
        raise BadInput(f"export --single: found --to {format}, wanted --to c")
    contents = c_header.files(correction, rate, single) if format == "c" else model_module.files(correction, rate)
    with keeping(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, data in contents.items():
        write_whole(folder / name, data)
    return [folder / name for name in contents]


def _stem(calibration: Calibration, format: str) -> str:
    """File name without suffix; raises BadInput for a calibration whose name is no file name."""
    plain = path_of(Path(), calibration.name).stem
    return python_module.module_stem(plain) if format == "python" else calibration.name
