"""Blind worlds over the wire: everything by the commands that a user has, each in a process of its own.

`rig demo hidden` prepares a sealed world behind sockets and takes the standard runs, `rig diagnose` names what is
missing, `rig add` adds it and gives the errors before and after. Only then `rig bench reveal` says what was hidden: any
effect that the simulated bench can hide, also those that are scored by class only.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import blind_worlds as worlds
from blind_scores import LARGEST_CLASS, Row, share

from rig.bench import control
from rig.bench.assembly import state_folder
from rig.bench.benchfile import describe
from rig.yaml.config import shipped

BENCH = "benches/simulated.yaml"
WORLDS, LEAST = 20, 2  # of a whole study (30 worlds for each effect); of the smallest
MOST = 4  # effects added to one model
STRONG = 10.0  # d′
LONGEST = 900.0  # s that one command may take
BY_NAME = frozenset(name for names in worlds.NAMES.values() for name in names)


class CommandFailed(Exception):
    """A command ended with another exit code than 0, or took too long."""


@dataclass(frozen=True)
class Shell:
    """A user's shell: runs are kept in a folder of their own."""

    folder: Path

    def asked(self, *words: str) -> Any:
        """What `rig … --json` prints. Raises CommandFailed."""
        command = [sys.executable, "-m", "rig", *words, "--json"]
        try:
            done = subprocess.run(
                command, cwd=self.folder, env=self._environment(), capture_output=True, text=True, timeout=LONGEST,
                check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise CommandFailed(f"rig {words[0]}: found nothing after {LONGEST:g} s") from error
        if done.returncode:
            raise CommandFailed(f"rig {' '.join(words)}: exit {done.returncode}: {done.stderr.strip()[-300:]}")
        return json.loads(done.stdout)

    def end(self) -> None:
        """Stop the simulated bench and remove the folder."""
        control.stop(state_folder(describe(shipped(BENCH)), self.folder / "runs"))
        shutil.rmtree(self.folder)

    def _environment(self) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("RIG_")}
        return {**kept, "RIG_RUNS": str(self.folder / "runs"), "OPENBLAS_NUM_THREADS": "1"}


def count(study: int) -> int:
    """Worlds over the wire in a study with so many worlds for each effect by name."""
    return max(round(WORLDS * study / 30), LEAST)


def seeds(worlds_: int, series: str = "1") -> list[int]:
    """Seeds of the sealed worlds."""
    return [zlib.crc32(f"{series}-wire-{number:03d}".encode()) >> 1 for number in range(worlds_)]


def place(seed: int, folder: Path) -> Path:
    """Where the result of a world is kept."""
    return folder / "wire" / f"{seed}.json"


def tried(seed: int, folder: Path) -> None:
    """One world from the first measurement to the truth; what went wrong is a result too."""
    work = (folder / "wire" / f"{seed}-work").resolve()
    shutil.rmtree(work, ignore_errors=True)  # of a study that was interrupted
    work.mkdir(parents=True)
    shell = Shell(work)
    try:
        result = _tried(shell, seed)
    except CommandFailed as error:
        result = {"verdict": "failed", "named": [], "classes": [], "why": str(error), "hidden": []}
    finally:
        shell.end()
    worlds.write(place(seed, folder), {"seed": seed, **result})


def _tried(shell: Shell, seed: int) -> dict[str, Any]:
    runs = list(shell.asked("demo", "hidden", "--seed", str(seed), "--yes")["runs"])
    said = shell.asked("diagnose", *runs)
    chosen = said["candidates"] if said["verdict"] == "missing" else []
    taken = firsts(chosen)
    errors = _added(shell, taken, runs)
    hidden = shell.asked("bench", "reveal")["effects"]  # the last command: nothing is concluded after it
    return {
        "verdict": said["verdict"], "named": [one["effect"] for one in taken],
        "classes": [one["class"] for one in taken], "probabilities": [one["probability"] for one in taken],
        "errors": errors, "hidden": hidden,
    }  # fmt: skip


def firsts(candidates: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The first candidate of each class; candidates of one class stand together."""
    made: list[Mapping[str, Any]] = []
    for one in candidates:
        if not any(one["effect"] in other["class"] for other in made):
            made.append(one)
    return made


def _added(shell: Shell, taken: Sequence[Mapping[str, Any]], runs: Sequence[str]) -> list[dict[str, Any]]:
    """Add what was named; the errors (noise = 1) of the model before, and after each."""
    errors: list[dict[str, Any]] = []
    for one in taken[:MOST]:
        on = ["--on", one["on"]] if one["on"] else []
        made = shell.asked("add", one["effect"], *runs, *on)
        errors += ([_error(made["before"])] if not errors else []) + [_error(made["after"])]
    return errors


def _error(step: Mapping[str, Any]) -> dict[str, Any]:
    return {name: step.get(name) for name in ("error", "heldout", "worst")}


def found(folder: Path) -> list[Mapping[str, Any]]:
    """All results, in the order of their seeds."""
    paths = sorted((folder / "wire").glob("*.json"))
    return [json.loads(path.read_text(encoding="utf-8")) for path in paths]


def _truth(one: Mapping[str, Any]) -> tuple[str, float]:
    """What was hidden and its strength d′; a world whose commands failed has neither."""
    return (one["hidden"][0]["name"], float(one["hidden"][0]["d_prime"])) if one["hidden"] else ("", math.inf)


def exact(one: Mapping[str, Any]) -> bool:
    """Exactly the hidden effect and nothing else."""
    return bool(one["verdict"] == "missing" and one["named"] == [_truth(one)[0]])


def in_class(one: Mapping[str, Any]) -> bool:
    """The first class holds the hidden effect and has at most three members."""
    first = one["classes"][0] if one["classes"] else []
    return len(first) <= LARGEST_CLASS and _truth(one)[0] in first


def rows(of: Sequence[Mapping[str, Any]]) -> Iterator[Row]:
    """Shares of exact and in the class, of all and of those that the study scores by name."""
    if not of:
        return
    named = [one for one in of if _truth(one)[0] in BY_NAME and _truth(one)[1] >= STRONG]
    yield _row("over the wire, by commands: exactly the hidden effect", of, exact)
    yield _row("… in a first class of ≤ 3", of, in_class)
    yield _row("… effects scored by name, d′ ≥ 10: exactly", named, exact)
    yield _row("… effects scored by name, d′ ≥ 10: in a first class of ≤ 3", named, in_class)
    if failed := [one for one in of if one["verdict"] == "failed"]:
        yield Row("… a command failed", share(len(failed), len(of)), "0", len(of))


def _row(what: str, of: Sequence[Mapping[str, Any]], good: Callable[[Mapping[str, Any]], bool]) -> Row:
    return Row(what, share(sum(map(good, of)), len(of)), "", len(of))


def table(of: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Head and a row for each world."""
    head = ("seed", "hidden", "d′", "verdict", "named", "exact", "in the class", "error before", "after", "held out")
    return [head, *(_listed(one) for one in of)]


def _listed(one: Mapping[str, Any]) -> tuple[str, ...]:
    name, strength = _truth(one)
    errors = one.get("errors") or [{}]
    yes = {True: "yes", False: "no"}
    said = (one["verdict"], " + ".join(one["named"]) or "nothing", yes[exact(one)], yes[in_class(one)])
    before = _number(errors[0].get("error"))
    after = (_number(errors[-1].get("error")), _number(errors[-1].get("heldout"))) if len(errors) > 1 else ("", "")
    return str(one["seed"]), name, f"{strength:.0f}", *said, before, *after


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
