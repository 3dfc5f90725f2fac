"""Sensors held still: Xsens turned by hand into 38 poses, and a Ferraris session with six faces and three turns."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from real_data_desk import (
    IMPORTS,
    Desk,
    climb,
    diagnosed,
    do_it,
    findings,
    ladder_table,
    notes,
    origin,
    table,
    worst,
)

SHARED = ("--start", "shared")
FERRARIS = "ferraris-session.yaml"


def xsens(desk: Desk) -> str:
    """One scale, three scales, and axes that are not square."""
    here = desk.at("xsens")
    said = here.imported(IMPORTS / "xsens-multiposition.yaml")
    diagnosis = here.asked("diagnose", "last", *SHARED)
    made = climb(here, ["own_sensitivity", "non_orthogonality --on acceleration"], SHARED)
    last = made.last.groups
    return XSENS.format(
        origin=origin("xsens-multiposition.yaml"), findings=findings(said), rows=said["files"][0]["rows"],
        records="\n".join(f"- {one}" for one in notes(here.text("diagnose", "last"))),
        before=made.first.error("gravity"), scales=made.rungs[1].error("gravity"), after=made.last.error("gravity"),
        worst=worst(made.first), diagnosis=diagnosed(diagnosis), ladder=ladder_table(made),
        angles=", ".join(f"{n} = {made.value('non_orthogonality', n).text}" for n in ("yz", "zy", "zx")),
        gyros=made.last.error("gyros"), gyro_ratio=last[-1]["ratio"], noise=last[0]["noise"], left=worst(made.last),
        gyro_degrees=math.degrees(made.last.error("gyros")),
        before_figure=desk.picture(made.first.png, "xsens-before.png", "Xsens: one sensitivity for all axes."),
        ladder_figure=desk.picture(made.ladder, "xsens-ladder.png", "Xsens: the ladder of the repair."),
        after_figure=desk.picture(made.last.png, "xsens-after.png", "Xsens: with sensitivities and angles."),
        commands=XSENS_COMMANDS,
    )  # fmt: skip


def ferraris(desk: Desk) -> str:
    """Six faces and three turns by 360°."""
    here = desk.at("ferraris")
    said = here.imported(IMPORTS / FERRARIS)
    diagnosis = here.asked("diagnose", "last", *SHARED)
    made = climb(here, ["own_sensitivity"], SHARED)
    model = yaml.safe_load((here.runs / "models" / "imucal-example.yaml").read_text(encoding="utf-8"))
    turned = list(turns(desk.data, model))
    return FERRARIS_TEXT.format(
        origin=origin(FERRARIS), findings=findings(said), rows=said["files"][0]["rows"],
        before=made.first.error("gravity"), after=made.last.error("gravity"), worst=worst(made.first),
        records="\n".join(f"- {one}" for one in notes(here.text("diagnose", "last"))),
        diagnosis=diagnosed(diagnosis), ladder=ladder_table(made), channels=table(CHANNELS, _channels(model)),
        turns=table(TURNS, ([name, *(f"{one:.2f}°" for one in row)] for name, row in turned)),
        before_figure=desk.picture(made.first.png, "ferraris-before.png", "Ferraris: one sensitivity for all axes."),
        ladder_figure=desk.picture(made.ladder, "ferraris-ladder.png", "Ferraris: the ladder of the repair."),
        after_figure=desk.picture(made.last.png, "ferraris-after.png", "Ferraris: a sensitivity for every axis."),
        commands=FERRARIS_COMMANDS,
    )  # fmt: skip


CHANNELS = ["channel", "sensitivity, numbers per SI unit", "relative to the file's unit", "zero, numbers of the file"]
TURNS = [
    "turn about",
    "as the file reads",
    "zero of the gyro taken off",
    "calibrated",
    "second axis, calibrated",
    "third axis, calibrated",
]


def _channels(model: Mapping[str, Any]) -> Iterator[list[str]]:
    for name, one in model["channels"].items():
        value, u = one["sensitivity"]["value"], one["sensitivity"]["u"]
        share = value * (math.pi / 180.0 if name.startswith("gyro") else 1.0)
        zero = next(iter(one["zero"].values()))
        yield [name, f"{value:.4f} ± {2.0 * u:.4f}", f"{share:.4f}", f"{zero:+.4f}"]


def turns(data: Path, model: Mapping[str, Any]) -> Iterator[tuple[str, list[float]]]:
    """For every turn, ° about its axis: as the file reads, without zero, calibrated; and the other two calibrated."""
    made = yaml.safe_load((IMPORTS / FERRARIS).read_text(encoding="utf-8"))
    with (data / made["files"][0]["path"]).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    step = 1.0 / float(made["time"]["rate"].split()[0])
    for segment in made["segments"]:
        if "turn" in segment:
            inside = rows[segment["first"] : segment["last"] + 1]
            own = _integrals(inside, segment["turn"], model, step)
            others = [_integrals(inside, axis, model, step)[2] for axis in "xyz" if axis != segment["turn"]]
            yield segment["turn"], [*own, *others]


def _integrals(
    rows: list[dict[str, str]], axis: str, model: Mapping[str, Any], step: float
) -> tuple[float, float, float]:
    """° about an axis: the numbers as they stand, without zero, and with zero and sensitivity of the model."""
    channel = model["channels"][f"gyro_{axis}"]
    zero, sensitivity = next(iter(channel["zero"].values())), channel["sensitivity"]["value"]
    raw = [float(row[f"gyr_{axis}"]) for row in rows]
    read, off = step * sum(raw), step * sum(one - zero for one in raw)
    return read, off, math.degrees(off / sensitivity)


XSENS_COMMANDS = do_it(
    "rig import configs/imports/xsens-multiposition.yaml --data …/data",
    "rig compare last --start shared",
    "rig diagnose last --start shared",
    "rig fit last --start shared",
    "rig add own_sensitivity last",
    "rig add non_orthogonality last --on acceleration",
    "rig history last",
)
FERRARIS_COMMANDS = do_it(
    "rig import configs/imports/ferraris-session.yaml --data …/data",
    "rig compare last --start shared",
    "rig diagnose last --start shared",
    "rig fit last --start shared",
    "rig add own_sensitivity last",
    "rig history last",
)

XSENS = """\
## imu-tk-xsens-multiposition: a unit turned by hand into many poses

**What was measured.** An Xsens MTi was put down in one attitude after another, with no fixture: {rows} rows of raw
counts in 512 s. The only reference is gravity: |g| = 9.81744 m/s² in Padua. {origin}

**What import said.** {findings}
The program finds the poses by itself and says what it did:

{records}

**What the first model missed.** We start with one sensitivity for all accelerometers (`--start shared`). The magnitude
of what they read at rest misses g by {before:.3g} m/s² rms:

{worst}

{before_figure}

**What the diagnosis said.** {diagnosis}

**What was added.** First a sensitivity for every axis, which helps little ({before:.3g} to {scales:.3g} m/s²), then the
angles between axes, which were the trouble: {angles}. The error is then {after:.2g} m/s².

{ladder}

{ladder_figure}

{after_figure}

**What is left over.** The magnitude of gravity is right within its noise ({noise:.2g} m/s²), also in the 15 poses that
were held out. Not so the gyros: at rest they keep {gyros:.2g} rad/s ({gyro_degrees:.2g} °/s), {gyro_ratio:.2g} times
their noise:

{left}

That is their zero wandering from pose to pose. The nearest effect of the shelf is a warm-up, and it explains almost
nothing of it, so none was added. How a triad sits in its case cannot be seen from magnitudes. The gyros' sensitivity is
not fitted, because no turn by a known angle is labelled; what import says of it, from the turns between the poses, is
that the nominal figure is a third off.

{commands}"""

FERRARIS_TEXT = """\
## imucal-ferraris: six faces and three turns

**What was measured.** The MaD-Lab in Erlangen laid a small unit on each of its six faces and then turned it by 360°
about each axis, by hand against a stop: {rows} rows. Which rows are which is labelled by the authors. The references
are gravity and the full turn. {origin}

**What import said.** {findings}
Of the records it says:

{records}

**What the first model missed.** With one sensitivity for all accelerometers and one for all gyros (`--start shared`;
zeros are free), gravity comes out wrong by {before:.3g} m/s² rms:

{worst}

{before_figure}

**What the diagnosis said.** {diagnosis}

**What was added.** A sensitivity for every channel.

{ladder}

The values found, zeros among them:

{channels}

{ladder_figure}

{after_figure}

The turns, integrated over the labelled rows (the nominal angle is −360°):

{turns}

The calibrated turn gives 360° because that is what it was calibrated with: one turn and one sensitivity per axis leave
nothing to check. The check is in the last two columns. During a turn about one axis the other two gyros should see
nothing, and they see a few degrees: the axis of a turn by hand is not quite the axis of the sensor. The program
allows 2° of tilt for that, and 1° of angle.

**What is left over.** Nothing above the noise. Six attitudes are fewer than the nine parameters of a triad, so zeros,
sensitivities and angles between axes cannot all be told apart; the program says so and does not try. Held out is the
last 40 % of the time of each pose. That judges noise and drift, not another attitude.

{commands}"""
