"""A circuit board on a shaker: most of what looks like a bad sensor is the shaker."""

from __future__ import annotations

from real_data_desk import IMPORTS, Desk, diagnosed, do_it, findings, notes, origin, rung, worst

NAME = "artslab-shaker.yaml"
ABOUT_SHAKER = ("the distortion", "the shaker")
ABOUT_LINES = ("the drive runs", "mains lines")


def section(desk: Desk) -> str:
    """No repair: the notes say what belongs to whom."""
    here = desk.at("artslab")
    said = here.imported(IMPORTS / NAME)
    first = rung(here, "start")
    diagnosis = here.asked("diagnose", "last")
    found = notes(here.text("diagnose", "last"))
    group = first.groups[0]
    return TEXT.format(
        origin=origin(NAME), findings=findings(said), files=len(said["files"]),
        lines=_chosen(found, ABOUT_LINES), shaker=_chosen(found, ABOUT_SHAKER),
        gain=_chosen(found, ("board over reference",)), unit=_chosen(found, ("the unit of",)),
        error=group["error"], noise=group["noise"], ratio=group["ratio"], worst=worst(first),
        figure=desk.picture(first.png, "artslab-start.png", "ARTS-Lab: board against base, one gain for all levels."),
        diagnosis=diagnosed(diagnosis), commands=COMMANDS,
    )  # fmt: skip


def _chosen(found: list[str], begin: tuple[str, ...]) -> str:
    return "\n".join(f"- {one}" for one in found if one.startswith(begin))


COMMANDS = do_it(
    "rig import configs/imports/artslab-shaker.yaml --data …/data",
    "rig compare last",
    "rig diagnose last",
)

TEXT = """\
## artslab-shaker-pcb: a shaker that distorts

**What was measured.** The ARTS-Lab of the University of South Carolina shook a circuit board with a sine of 5 Hz at
many settings of amplifier and command. One accelerometer sits on the shaker's base (the reference here), one on the
board (the device); the drive's voltage was recorded too. We use {files} files, one of them at rest. The units of the
accelerometers are not stated, so the numbers are taken as they stand. {origin}

**What import said.** {findings}
The last two findings look like files that were named one setting too low: the drive recorded at setting 0.8 is that of
0.9, and that of 0.9 is that of 1. The program does not rename anything. The time base is settled by the mains:
its lines come out where they should, so the recorder is right and the drive is fast.

**What compare said of the records.** Lines first, so that nothing else is blamed for them:

{lines}

Then the harmonics. Both channels have them alike, so they are motion:

{shaker}

And the gain of the board over the base, level by level:

{gain}

The figure is one number within a few thousandths over a wide range of levels. A mismatch of two sensitivities looks
like that; a nonlinear sensor does not.

**What the first model missed.** One gain for everything, with the base's own harmonics as input, leaves {error:.2g} (in
the file's unit), against a noise of {noise:.2g}: {ratio:.3g} times.

{worst}

{figure}

**What the diagnosis said.** {diagnosis}

**What was added.** Nothing. A few tenths of a percent of the gain change with the level and with the harmonic, and no
effect of the shelf explains both. The noise at rest is very small, so "many times the noise" is still less than one
percent of the motion. With one frequency only, a phase of the board's mounting, a delay and a filter cannot be told
apart, and the base accelerometer has no stated uncertainty that would say how good it is itself. The diagnosis is
asked for physics of a sensor, and its nearest effects leave the error far from the noise: that is the reason not to
add them. On units the program says:

{unit}

{commands}"""
