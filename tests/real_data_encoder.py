"""Two MPU-6050 on a stepper-driven rig with an encoder: late gyros, less late accelerometers, motion that is real."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from real_data_desk import (
    IMPORTS,
    Climb,
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

from rig.foreign.pairs import running
from rig.foreign.tables import Foreign, foreign_of
from rig.notebook import open_run
from rig.signals.spectrum import welch

Array = NDArray[np.float64]
YAW = ("reference_tilt", "delay --on rate")
PITCH = ("reference_tilt", "reference_delay", "delay --on rate", "cross_axis --on acceleration")
TRIALS = {
    "yaw medium": ("uiuc-yaw-medium.yaml", YAW),
    "yaw slow": ("uiuc-yaw-slow.yaml", YAW),
    "pitch medium": ("uiuc-pitch-medium.yaml", PITCH),
    "roll slow": ("uiuc-roll-slow.yaml", PITCH),
}
STEP = 3.6  # ° of turning between two pushes of the motor: two full steps of 1.8°
SEGMENT = 10.0  # s
STANDS_OUT = 5.0  # power of a line over the median around it


@dataclass(frozen=True)
class Line:
    """A line that gyro and encoder both have: where, rms of either in °/s, and the mean speed of turning in °/s."""

    frequency: float
    gyro: float
    encoder: float
    speed: float


def section(desk: Desk) -> str:
    """Yaw in full, pitch for the accelerometers, the other two in a table."""
    yaw, pitch = desk.at("yaw-medium"), desk.at("pitch-medium")
    said = yaw.imported(IMPORTS / "uiuc-yaw-medium.yaml")
    yaw_said = yaw.asked("diagnose", "last")
    made = climb(yaw, YAW)
    pitch.imported(IMPORTS / "uiuc-pitch-medium.yaml")
    pitch_said = pitch.asked("diagnose", "last")
    swung = climb(pitch, PITCH)
    others = [_other(desk, name) for name in ("yaw slow", "roll slow")]
    trials = {"yaw medium": made, "pitch medium": swung, **dict(others)}
    lines = [line_of(desk.at(name.replace(" ", "-")), TRIALS[name][0]) for name in TRIALS]
    return TEXT.format(
        origin=origin("uiuc-yaw-medium.yaml"), findings=findings(said), sign=_sign(yaw),
        before=made.first.error("gyros"), after=made.last.error("gyros"), ratio=made.history[0]["error"],
        fall=made.first.error("gyros") / made.last.error("gyros"),
        tilted=made.rungs[1].error("gyros"), tilted_fall=made.rungs[1].error("gyros") / made.last.error("gyros"),
        worst=worst(made.first), yaw=diagnosed(yaw_said), yaw_ladder=ladder_table(made),
        before_figure=desk.picture(made.first.png, "uiuc-yaw-before.png", "Yaw: the data sheet's model."),
        after_figure=desk.picture(made.last.png, "uiuc-yaw-after.png", "Yaw: with tilt and delay."),
        ladder_figure=desk.picture(made.ladder, "uiuc-yaw-ladder.png", "Yaw: the ladder of the repair."),
        gyro_delay=made.value("delay", "time").text, pitch=diagnosed(pitch_said), pitch_ladder=ladder_table(swung),
        pitch_figure=desk.picture(swung.first.png, "uiuc-pitch-before.png", "Pitch: the data sheet's model."),
        common=_milli(-swung.value("reference_delay", "time").value), more=swung.value("delay", "time").text,
        force_before=swung.first.error("accelerometers"), force_after=swung.last.error("accelerometers"),
        arm=_arm(yaw), trials=table(TRIAL_HEAD, [_row(name, one) for name, one in trials.items()]),
        lines=table(LINE_HEAD, _line_rows(lines)), commands=COMMANDS,
    )  # fmt: skip


def _other(desk: Desk, name: str) -> tuple[str, Climb]:
    here = desk.at(name.replace(" ", "-"))
    manifest, steps = TRIALS[name]
    here.imported(IMPORTS / manifest)
    return name, climb(here, steps)


def _sign(here: Desk) -> str:
    return next(one for one in notes(here.text("diagnose", "last")) if one.startswith("sign:"))


def _arm(here: Desk) -> str:
    """What the diagnosis of the repaired yaw model still proposes."""
    found = here.asked("diagnose", "last")["candidates"]
    arm = next((one for one in found if one["effect"] == "lever_arm"), None)
    if arm is None:
        return "The diagnosis of the repaired model proposes nothing more."
    from rig.fit.parameters import Estimate

    length = arm["parameters"]["length"]
    size = Estimate(length["value"], length["unit"], length["u"]).text
    return (
        f"The diagnosis of the repaired model still proposes a lever arm of {size}. It would take the "
        f"error to {arm['error_after']:.4g} times the noise. "
        + ("" if arm["plausible"] else "The program itself calls that size unusual. ")
        + "We have left it out: at these speeds it explains some hundredths of a metre per second squared, no more "
        "than one step of the accelerometer's resolution of 0.01 g."
    )


def _milli(seconds: float) -> str:
    return f"{1e3 * seconds:.2f} ms"


TRIAL_HEAD = [
    "trial",
    "gyros late by",
    "accelerometers late by",
    "gyros before, rad/s",
    "after",
    "accelerometers before, m/s²",
    "after",
]


def _row(name: str, made: Climb) -> list[str]:
    late, common = delays(made)
    return [
        name, _milli(late), "not seen" if common is None else _milli(common),
        f"{made.first.error('gyros'):.3g}", f"{made.last.error('gyros'):.3g}",
        f"{made.first.error('accelerometers'):.3g}", f"{made.last.error('accelerometers'):.3g}",
    ]  # fmt: skip


def delays(made: Climb) -> tuple[float, float | None]:
    """How late gyros and accelerometers are after the reference, s; None where the axis stands upright."""
    own = made.value("delay", "time").value
    if not any(one["effect"] == "reference_delay" for one in made.effects):
        return own, None
    common = -made.value("reference_delay", "time").value
    return common + own, common


# lines above the band


def line_of(here: Desk, manifest: str) -> tuple[str, Line | None]:
    """The strongest line above 5 Hz that stands in gyro and encoder alike and is no part of the to and fro."""
    data = foreign_of(open_run(here.runs / "last"))
    return manifest.removeprefix("uiuc-").removesuffix(".yaml").replace("-", " "), push_of(data)


def push_of(data: Foreign) -> Line | None:
    """The line near the mean speed over two full steps of the motor, if gyro and encoder both have it there."""
    rate, gyro, encoder = _even(data)
    steady = np.convolve(np.gradient(encoder) * rate, np.ones(20) / 20.0, "same")
    speed = float(np.median(np.abs(steady)))
    turned, shown = welch(gyro, rate, SEGMENT), welch(encoder, rate, SEGMENT)
    moved = shown.density * (2.0 * np.pi * shown.frequency) ** 2  # of the angle's rate, exact at every frequency
    near = np.abs(turned.frequency - speed / STEP) < 0.03 * speed / STEP
    at = int(np.flatnonzero(near)[np.argmax(turned.density[near])])
    if min(_height(turned.density, at), _height(moved, at)) < STANDS_OUT:
        return None
    around, width = slice(max(at - 2, 0), at + 3), float(turned.frequency[1] - turned.frequency[0])
    sizes = [float(np.sqrt(np.sum(one[around]) * width)) for one in (turned.density, moved)]
    return Line(float(turned.frequency[at]), sizes[0], sizes[1], speed)


def _height(power: Array, at: int, half: int = 30) -> float:
    return float(power[at] / np.median(power[max(at - half, 0) : at + half]))


def _even(data: Foreign) -> tuple[float, Array, Array]:
    """Rate in Hz, gyro of the turning axis in °/s and encoder in °, on an even grid of time."""
    columns, table_ = data.manifest.columns, data.tables[0]
    rows, time = running(data, table_)
    axis = data.manifest.rotation.axis if data.manifest.rotation else "z"
    gyro = next(one for one in columns if one.quantity == "rate" and one.axis == axis)
    angle = next(one for one in columns if one.quantity == "angle")
    grid = np.linspace(time[0], time[-1], len(time))
    made = [np.degrees(np.interp(grid, time, data.si(table_, one)[rows])) for one in (gyro, angle)]
    return (len(grid) - 1) / float(grid[-1] - grid[0]), made[0], made[1]


LINE_HEAD = ["trial", "mean speed", "speed ÷ 3.6°", "line found at", "gyro, rms", "encoder, rms", "gyro ÷ encoder"]


def _line_rows(found: list[tuple[str, Line | None]]) -> Iterator[list[str]]:
    for name, one in found:
        if one is None:
            yield [name, *("none",) * 6]
            continue
        yield [
            name, f"{one.speed:.1f} °/s", f"{one.speed / STEP:.2f} Hz", f"{one.frequency:.2f} Hz",
            f"{one.gyro:.2f} °/s", f"{one.encoder:.2f} °/s", f"{one.gyro / one.encoder:.2f}",
        ]  # fmt: skip


COMMANDS = do_it(
    "rig import configs/imports/uiuc-yaw-medium.yaml --data …/data",
    "rig compare last",
    "rig diagnose last",
    "rig fit last",
    "rig add reference_tilt last",
    "rig add delay last --on rate",
    "rig history last",
    "rig import configs/imports/uiuc-pitch-medium.yaml --data …/data --runs runs/pitch",
    "rig diagnose last --runs runs/pitch",
    *(
        f"rig add {step.replace(' --', ' last --') if ' ' in step else f'{step} last'} --runs runs/pitch"
        for step in PITCH
    ),
    "rig history last --runs runs/pitch",
)

TEXT = """\
## uiuc-mpu6050-encoder: two MPU-6050 on a stepper rig with an encoder

**What was measured.** At the University of Illinois a stepper motor turned an MPU-6050 to and fro while a second one
stood still; an encoder on the shaft gave the angle in steps of about 0.09°. Everything was logged at nominally
100 Hz. Yaw turns about an upright axis, so only gyros feel it; pitch and roll turn gravity through the accelerometers
as well. We look at 120 s of four trials. {origin}

**What import said (yaw medium).** {findings}
**What the first model missed (yaw medium).** Rates are compared up to 5 Hz. The data sheet's model leaves
{before:.3g} rad/s rms in the gyros, {ratio:.3g} times the noise:

{worst}

{before_figure}

The sign is settled before anything is fitted, and said with every answer: "{sign}".

**What the diagnosis said (yaw medium).** {yaw}

Read that as two statements. First, the case is not square to the shaft: each gyro shows a share of the turning, as
from a tilt of about a degree. Second, the gyros are late. Below 5 Hz a delay, a moving average and a filter of three or
four poles are nearly the same thing: whichever stands first above, the errors of the others agree with it to a few
thousandths, and all of them mean about 12 ms. This band does not show which is *the* cause. We have added the
plainest, the delay.

**What was added (yaw medium).** A tilt of the reference's frame and a delay of the gyros of {gyro_delay}.

{yaw_ladder}

The gyro error falls {fall:.3g} times, from {before:.3g} to {after:.3g} rad/s; the delay alone is worth
{tilted_fall:.3g} times ({tilted:.3g} to {after:.3g}). Held out are the last 40 % of the time.

{ladder_figure}

{after_figure}

**The accelerometers (pitch medium).** When gravity turns, the accelerometers show a delay of their own. `rig compare`
begins like this:

{pitch_figure}

{pitch}

Two delays can be written in two ways: each kind of channel with its own, or a part that all share
(`reference_delay`) and what the gyros have beyond it (`delay` of the rates). Filters of the same lateness leave
nearly the same error here too. We take the common part and the excess, because that shows what cannot be attributed:

{pitch_ladder}

Common to all channels are {common}: that is how late the accelerometers are after the encoder. The gyros are
{more} later still. Whether the common part is the sensor's filter or the encoder's way
through the logger cannot be told from these files; the program says so. The accelerometer error falls from
{force_before:.3g} to {force_after:.3g} m/s².

All four trials, each fitted for itself:

{trials}

The delay of the gyros is the same within a millisecond in trials whose speeds differ by a factor of four, and
so is that of the accelerometers. A dead zone or a limit of the rate would not do that. The roll trial differs most; it
is also the one whose time stamps are logged worst.

**Real motion above the band.** What is left in the gyros is not all error. A stepper pushes once per step; with
a pair of unlike phases the push comes once in two full steps of 1.8°, so at the mean speed divided by 3.6° (that this
motor has such steps is our guess; the line is not). We looked for that line in the records, with the program's own
spectra (`rig.open_run`, `rig.signals.spectrum.welch`, segments of ten seconds):

{lines}

The line stands where the speed puts it, in gyro and encoder alike: the case really shakes, and the line is motion and
not noise of the sensor. The last column says more than a comparison below 5 Hz can. Near 13 Hz the gyro follows the
encoder almost fully, near 47 Hz it does not (nor is that a line near 53 Hz folded by the sampling of 100 Hz: the speed
says 47). So part of the 12 ms is likely a low-pass filter in the sensor. `rig compare` says the same of the slow trials
by itself ("real motion above the band, in gyro and encoder alike: lines at 12.8 Hz"); the line at 47 Hz it does not
name, because jitter of the time stamps takes the coherence of gyro and encoder away there.

**What is left over.** Jitter of the logger, the encoder's steps, and the shaking. {arm}

{commands}"""
