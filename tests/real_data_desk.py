"""The desk of `make real-data`: runs the commands of a user on one data set and turns what they say into Markdown."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import in_process
import yaml

from rig.fit.parameters import Estimate

ROOT = Path(__file__).parents[1]
IMPORTS = ROOT / "configs" / "imports"
IMAGES = "images/real-data"  # seen from the page
COLOURS = 48  # of a picture; keeps the files small
UNITS = {
    "gyros": "rad/s",
    "accelerometers": "m/s²",
    "gravity": "m/s²",
    "response": "of H",
    "board": "units of the file",
}
SPAN = "within what the model fits anyway"  # begins the longest of the things that data cannot see

Json = Mapping[str, Any]


class Failed(Exception):
    """A command that did not end well."""


@dataclass(frozen=True)
class Desk:
    """Where the real data are, a folder of runs, and where pictures go."""

    data: Path
    runs: Path
    images: Path

    def at(self, name: str) -> Desk:
        """The same with a folder of runs of its own, so that `last` is the data set in hand."""
        return Desk(self.data, self.runs / name, self.images)

    def text(self, *words: str) -> str:
        """What `rig WORDS` prints. Raises Failed."""
        done = in_process.rig(*words, "--runs", str(self.runs))
        if done.returncode:
            raise Failed(f"rig {' '.join(words)}: exit {done.returncode}\n{done.stdout[-800:]}{done.stderr[-800:]}")
        return done.stdout.replace(f" --runs {self.runs}", "")  # a folder that is thrown away

    def asked(self, *words: str) -> Any:
        """What `rig WORDS --json` says."""
        return json.loads(self.text(*words, "--json"))

    def imported(self, manifest: Path) -> Json:
        """Import by a manifest; what import says."""
        said: Json = self.asked("import", str(manifest), "--data", str(self.data))
        return said

    def picture(self, png: bytes, name: str, caption: str) -> str:
        """Keep a picture small for the page; its line of Markdown."""
        from PIL import Image

        self.images.mkdir(parents=True, exist_ok=True)
        drawn = Image.open(io.BytesIO(png)).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        drawn.save(self.images / name, optimize=True)
        return f"![{caption}]({IMAGES}/{name})\n*{caption}*"


@dataclass(frozen=True)
class Rung:
    """One step of a repair as `rig compare` sees it: errors by group, the worst conditions, and the figure."""

    name: str
    groups: Sequence[Json]
    worst: Sequence[str]
    png: bytes

    def error(self, family: str) -> float:
        """The error of a family of channels, SI; KeyError if there is none."""
        for group in self.groups:
            if family in group["name"]:
                return float(group["error"])
        raise KeyError(family)


def rung(desk: Desk, name: str, *words: str) -> Rung:
    """Compare the model as it is now."""
    found = desk.asked("compare", "last", "--png", *words)
    png = next((Path(one).read_bytes() for one in found["figures"] if one.endswith(".png")), b"")
    worst = [one["in_words"] for one in found["worst"] if "nothing stands out" not in one["in_words"]]
    return Rung(name, found["groups"], worst, png)


@dataclass(frozen=True)
class Climb:
    """A repair from its first model on, and its history; `ladder` is the figure of `rig history`."""

    rungs: Sequence[Rung]
    history: Sequence[Json]
    effects: Sequence[Json]
    ladder: bytes

    @property
    def first(self) -> Rung:
        return self.rungs[0]

    @property
    def last(self) -> Rung:
        return self.rungs[-1]

    def value(self, effect: str, name: str) -> Estimate:
        """A parameter of the last model with its unit and standard uncertainty."""
        for one in self.effects:
            if one["effect"] == effect:
                found = one["parameters"][name]
                return Estimate(found["value"], found["unit"], found["u"])
        raise KeyError(effect)


def climb(desk: Desk, steps: Sequence[str], start: Sequence[str] = ()) -> Climb:
    """Start a model of the last run, then add effects one by one: `delay --on rate`. Compares after each."""
    rungs = [rung(desk, "start", *start)]
    desk.text("fit", "last", *start)
    effects: Sequence[Json] = []
    for step in steps:
        effect, *on = step.split()
        effects = desk.asked("add", effect, "last", *on)["effects"]
        rungs.append(rung(desk, effect + (f" ({on[-1]})" if on else "")))
    said = desk.asked("history", "last")
    ladder = next(Path(one).read_bytes() for one in said["figures"] if one.endswith(".png"))
    history = [one for one in said["history"] if one["action"] in ("start", "add")]  # a refit is no step of its own
    return Climb(rungs, history, effects, ladder)


# Markdown


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ladder_table(made: Climb) -> str:
    """Errors of every step in SI, and against the noise on everything and on what was held out."""
    names = [group["name"].split(", ")[-1] for group in made.first.groups]
    head = ["model", *(f"{name}, {unit_of(name)}" for name in names), "error ÷ noise", "held out ÷ noise"]
    rows = [
        [("" if number == 0 else "+ ") + one.name, *(f"{group['error']:.3g}" for group in one.groups),
         f"{step['error']:.3g}", f"{step['heldout']:.3g}"]
        for number, (one, step) in enumerate(zip(made.rungs, made.history, strict=True))
    ]  # fmt: skip
    noise = ["(noise)", *(f"{group['noise']:.3g}" for group in made.first.groups), "1", "1"]
    return table(head, [*rows, noise])


def unit_of(name: str) -> str:
    """The unit of a group's error."""
    return next((unit for word, unit in UNITS.items() if word in name), "SI")


def origin(manifest: str) -> str:
    """Source, licence and citation as the manifest states them."""
    stated = yaml.safe_load((IMPORTS / manifest).read_text(encoding="utf-8"))["provenance"]
    return f"Source: {stated['source']}. Licence: {stated['licence']}. Cite: {stated['citation']}."


def findings(said: Json) -> str:
    """What import found and did not mend."""
    found = said["findings"]
    if not found:
        return "`rig import` found nothing to object to in the file.\n"
    head = "`rig import` reads the file as it stands and reports, without mending:\n\n"
    return head + "\n".join(f"- {one['text']}" for one in found) + "\n"


def worst(one: Rung) -> str:
    """The worst conditions in the program's words."""
    return "\n".join(f"- {words}" for words in one.worst) or "- nothing stands out of the noise"


def diagnosed(said: Json) -> str:
    """A diagnosis: what was found step by step, with what ranked below, and what the data cannot see."""
    effects = " and ".join(named(one) for one in firsts(said))
    match said["verdict"]:
        case "missing":
            head = f"`rig diagnose` says: **missing {effects}**."
        case "adequate":
            head = "`rig diagnose` says: **adequate** - nothing but noise is left."
        case verdict:
            head = f"`rig diagnose` says: **{verdict}** - the shelf does not explain everything" + (
                f"; nearest are {effects}." if effects else "."
            )
    lines = [head, "", *_steps(said), "", "It adds what this data cannot see:", "", *_unseen(said)]
    return "\n".join(lines)


def firsts(said: Json) -> list[Json]:
    """The candidate taken at every step."""
    return [one for one in said["candidates"] if one["taken"]]


def named(one: Json) -> str:
    on = f" ({one['on']})" if one.get("on") else ""
    return f"{one['effect']}{on}"


def values(parameters: Json) -> str:
    """Parameters with expanded uncertainty."""
    return ", ".join(f"{name} = {Estimate(v['value'], v['unit'], v['u']).text}" for name, v in parameters.items())


def _steps(said: Json) -> Iterator[str]:
    for one in firsts(said):
        number = one["step"]
        yield (
            f"{number}. **{named(one)}**: {values(one['parameters'])}. Error with it {one['error_after']:.4g} times "
            f"the noise, held out {one['heldout_error_after']:.4g}. Because {one['because']}."
        )
        for other in said["candidates"]:
            if other["step"] == number and not other["taken"]:
                said_of = f"{named(other)}, {values(other['parameters'])}, error {other['error_after']:.4g}"
                yield f"   - not told apart from it: {said_of}"
        for below in said["excluded"]:
            if below["step"] == number:
                left = below["error_after"]
                said_of = "not refitted" if left is None else f"would leave {left:.4g}"
                yield f"   - ranked below: {below['effect']}, {said_of} ({below['why']})"


def _unseen(said: Json) -> list[str]:
    return [f"- {one}" for one in said["cannot_see"] if not one.startswith(SPAN)]


def do_it(*lines: str) -> str:
    """The commands to do it oneself."""
    return "Do it yourself:\n\n```console\n" + "\n".join(f"$ {line}" for line in lines) + "\n```\n"


def notes(text: str) -> list[str]:
    """What a command says of the records."""
    found = text.partition("of the records:\n")[2]
    return [line.strip() for line in found.splitlines() if line.startswith("  ")]
