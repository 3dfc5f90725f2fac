"""A response as two national institutes measured it: a delay and a moving average, then a prediction."""

from __future__ import annotations

from collections.abc import Iterator

from real_data_desk import (
    IMPORTS,
    Climb,
    Desk,
    Json,
    diagnosed,
    do_it,
    findings,
    ladder_table,
    notes,
    origin,
    table,
    worst,
)

RIVALS = {
    "first_order_lag, delay": "first-order lag",
    "resonance, delay": "second order (a resonance)",
    "bessel_filter, delay": "three-pole Bessel filter",
    "butterworth_filter": "four-pole Butterworth filter",
    "moving_average, butterworth_filter": "moving average and four-pole Butterworth filter",
}


def section(desk: Desk) -> str:
    """PTB and CEM."""
    here = desk.at("ptb")
    said = here.imported(IMPORTS / "ptb-mpu9250.yaml")
    diagnosis = here.asked("diagnose", "last")
    made = climb_of(here)
    rivals = list(_rivals(here))
    cem = here.imported(IMPORTS / "cem-mpu9250.yaml")
    held = here.asked("compare", "last", "--as-is")
    return TEXT.format(
        origin=origin("ptb-mpu9250.yaml"), findings=findings(said), rows=said["files"][0]["rows"],
        before=made.first.error("response"), ratio=made.history[0]["error"], worst=worst(made.first),
        before_figure=desk.picture(made.first.png, "ptb-before.png", "PTB: the first model, a gain alone."),
        diagnosis=diagnosed(diagnosis), ladder=ladder_table(made), after=made.last.error("response"),
        fall=made.first.error("response") / made.last.error("response"),
        time=made.value("delay", "time").text, window=made.value("moving_average", "window").text,
        whole=1e3 * (made.value("delay", "time").value + 0.5 * made.value("moving_average", "window").value),
        ladder_figure=desk.picture(made.ladder, "ptb-ladder.png", "PTB: the ladder of the repair."),
        after_figure=desk.picture(made.last.png, "ptb-after.png", "PTB: what delay and moving average leave over."),
        rivals=table(["model", "rms error of H", "error ÷ noise"], rivals), cem=findings(cem),
        as_is=held["groups"][0]["error"], as_is_ratio=held["groups"][0]["ratio"],
        levelled=held["with_levels"][0]["error"], levelled_ratio=held["with_levels"][0]["ratio"],
        level=100.0 * held["levels"][0]["relative"], level_u=200.0 * held["levels"][0]["u"],
        notes="\n".join(f"> {one}\n>" for one in _said_of(here)).removesuffix("\n>"),
        commands=COMMANDS,
    )  # fmt: skip


def climb_of(here: Desk) -> Climb:
    """From a gain alone to the full model."""
    from real_data_desk import climb

    return climb(here, ["delay --on acceleration", "moving_average --on acceleration"])


def _rivals(here: Desk) -> Iterator[list[str]]:
    """Other models of the same table, each in a model file of its own."""
    for number, (effects, name) in enumerate(RIVALS.items()):
        model = str(here.runs / f"rival-{number}.yaml")
        for effect in effects.split(", "):
            on = () if effect == "resonance" else ("--on", "acceleration")
            made: Json = here.asked("add", effect, "last", *on, "--model", model)
        group = here.asked("compare", "last", "--model", model)["groups"][0]
        words = ("delay and " if "delay" in effects else "") + name
        yield [words, f"{group['error']:.3g}", f"{made['after']['error']:.4g}"]


def _said_of(here: Desk) -> list[str]:
    return [one for one in notes(here.text("compare", "last", "--as-is")) if "counts against" in one]


COMMANDS = do_it(
    "export RIG_REAL_DATA=…/data",
    "rig import configs/imports/ptb-mpu9250.yaml",
    "rig compare last",
    "rig diagnose last",
    "rig add delay last --on acceleration",
    "rig add moving_average last --on acceleration",
    "rig history last",
    "rig import configs/imports/cem-mpu9250.yaml",
    "rig compare last --as-is",
)

TEXT = """\
## ptb-cem-mpu9250-shaker: one accelerometer at two national institutes

**What was measured.** One MPU-9250 on a board of the Met4FoF project (SmartUp), shaken with sines of 10 to 250 Hz at
PTB (Germany) and later at CEM (Spain). The reference is each institute's primary vibration calibration, with lasers.
What is published is not a record but a table: magnitude and phase of the response H, sensor over reference, with
their uncertainties. PTB's table has {rows} rows, ten sweeps of 17 frequencies. {origin}

**What import said.** {findings}
**What the first model missed.** The first model of a table is a sensitivity and nothing else. It leaves {before:.3g}
rms of H, {ratio:.4g} times the stated noise, which is most of the response. `rig compare` says where:

{worst}

{before_figure}

**What the diagnosis said.** {diagnosis}

So it is neither a single lag nor a second-order system. The reason is in the two curves together: the phase is a
straight line in f to a few hundredths of a degree, and the magnitude still falls by a third. A lag or a resonance that
bends the magnitude so far bends the phase as well; an average over a fixed window does not. It is symmetric in time,
so its phase is that of a pure delay by half the window.

**What was added.** A delay of {time} and a moving average over {window}: the
sum, delay and half the window, is {whole:.4g} ms.

{ladder}

The error falls {fall:.0f} times, to {after:.2g} rms of H. Every third frequency is held out: the fit
that is judged there has not seen it.

{ladder_figure}

{after_figure}

Rivals, fitted to the same rows with their best values:

{rivals}

(What the diagnosis ranks below is judged beside the effects of the other steps, so its figures for single effects
are those of pairs.) The last row deserves a second look. A filter of four poles far above the band acts as a delay and
hardly bends the magnitude, so it may stand in for the delay, though not for the average. The table prefers the plain
delay by little. That there is an average over a window is not in doubt; what makes up the rest of the delay is. A sweep
past 1/window (about 500 Hz) would show more: the gain of an average is zero there.

**The other institute.** CEM measured the same unit. {cem}
`rig compare last --as-is` holds PTB's values and only asks whether they predict CEM's table. As it is, the error is
{as_is:.2g} rms of H ({as_is_ratio:.3g} times the noise); with one factor for the whole table {levelled:.2g}
({levelled_ratio:.3g} times). The shape holds. What differs is

- a level of {level:+.3f} % ± {level_u:.3f} % (k = 2), the same at every frequency: sensitivity, reference or mounting,
  and not
  the sensor's dynamics;
- the polarity, half a turn of phase at the lowest frequency. In the program's words:

{notes}

**What is left over, and what cannot be told.** Nothing above the stated uncertainty. The excitation rises with
frequency, so an effect of level would look like one of frequency. A delay of the sensor and one of the time base that
it is compared by cannot be told apart; that CEM's table has the same delay speaks for the sensor's side.

{commands}"""
