"""`make real-data`: docs/real-data.md, written by running the commands of a user on other people's measurements.

    python tests/real_data.py --data ../shared/data --page docs/real-data.md [--only ptb]

Every data set has a function that imports, compares, diagnoses and repairs in a folder of runs that is thrown away
afterwards, and returns its section. Numbers and quoted words come from the run; the prose around them is fixed, and
tests/test_real_data.py holds the results that the prose relies on. Takes about five minutes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import real_data_encoder
import real_data_motion
import real_data_poses
import real_data_response
import real_data_shaker
from real_data_desk import ROOT, Desk, Failed

SECTIONS: dict[str, Callable[[Desk], str]] = {
    "ptb-cem-mpu9250-shaker": real_data_response.section,
    "uiuc-mpu6050-encoder": real_data_encoder.section,
    "broad-imu-optitrack": real_data_motion.section,
    "imu-tk-xsens-multiposition": real_data_poses.xsens,
    "imucal-ferraris": real_data_poses.ferraris,
    "artslab-shaker-pcb": real_data_shaker.section,
}
INTRODUCTION = """\
# Real data: six measurements that nobody here made

This page is written by `make real-data DATA=FOLDER`. It brings six published data sets in, compares the model with
them, asks what is missing, adds it, and reports the error before and after. The data are not part of this project;
every section names its source and licence, and the manifests in `configs/imports/` say which file and column is what.
FOLDER holds one folder per data set, named as the sections below.

How to read the figures. *Error* is the rms of what the model leaves over, in SI units where the data have them. *Error
÷ noise* divides each number by its own noise, found independently of the model; 1 is noise and nothing else. *Held
out* is data that the fit judged by it has not seen. Uncertainties are expanded (k = 2). How the diagnosis works is
in [model repair](explanation/model-repair.md), how to import your own files in
[import foreign data](how-to/import-foreign-data.md).
"""


def main(words: Sequence[str] | None = None) -> int:
    """Write the page; 2 if the data are not there, 1 if a command failed."""
    asked = _asked(words)
    missing = [name for name in SECTIONS if not (asked.data / name).is_dir()]
    if missing:
        print(
            f"{asked.data}: found no {', '.join(missing)}, wanted a folder for each; next: make real-data DATA=FOLDER"
        )
        return 2
    with tempfile.TemporaryDirectory(prefix="real-data-") as folder:
        desk = Desk(asked.data.resolve(), Path(folder), asked.page.parent / "images" / "real-data")
        try:
            made = {name: _timed(name, desk) for name in SECTIONS if asked.only in (None, name)}
        except Failed as failed:
            print(failed)
            return 1
    _write(asked.page, made)
    print(f"page: {asked.page}\nnext: look at it, then commit it with {asked.page.parent / 'images' / 'real-data'}")
    return 0


def _asked(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Write the page on real data.")
    default = os.environ.get("RIG_REAL_DATA", str(ROOT.parent / "shared" / "data"))
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of the data sets")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "real-data.md")
    parser.add_argument("--only", choices=list(SECTIONS), help="renew one section of the page")
    return parser.parse_args(words)


def _timed(name: str, desk: Desk) -> str:
    begun = time.monotonic()
    made = SECTIONS[name](desk)
    print(f"{name}: {time.monotonic() - begun:.0f} s", flush=True)
    return made


def _write(page: Path, made: dict[str, str]) -> None:
    """The page; sections that were not made anew stay as they stand there."""
    old = _sections(page) if page.exists() else {}
    kept = [made.get(name) or old.get(name, "") for name in SECTIONS]
    page.parent.mkdir(parents=True, exist_ok=True)
    text = "\n".join([INTRODUCTION, *(one.strip() + "\n" for one in kept if one)])
    page.write_text(text, encoding="utf-8")


def _sections(page: Path) -> dict[str, str]:
    parts = page.read_text(encoding="utf-8").split("\n## ")[1:]
    return {part.partition(":")[0]: f"## {part}" for part in parts}


if __name__ == "__main__":
    sys.exit(main())
