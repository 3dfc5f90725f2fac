"""The table of the fault matrix: what can go wrong on a bench, in which instrument's hands, during which procedure.

A fault of bytes is spoilt on the line by the proxy (`wire_proxy`); what is wrong with cables, hands and clocks is wrong
in the world (`miswired`, and the twins' own faults).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from faulty_bench import PROCEDURES, Cell
from miswired import Poses, Wrong, mounted, turned
from wire_proxy import Spoilt

LATE = 4.0  # s; later than any driver here waits for
CONVERTER = ("sweep", "turntable", "tumble", "noise")  # procedures that the converter records

TEXT: Mapping[str, Spoilt] = {
    "silence": Spoilt("silence"), "late": Spoilt("late", size=LATE), "truncated": Spoilt("truncated"),
    "garbage": Spoilt("garbage"), "duplicated": Spoilt("duplicated"), "previous answer": Spoilt("previous"),
    "one answer behind": Spoilt("behind"), "NaN": Spoilt("not_a_number"), "overload number": Spoilt("overload"),
    "flipped bit": Spoilt("flipped", bit=1), "disconnect": Spoilt("disconnect"), "hung": Spoilt("hung"),
}  # fmt: skip
"""Of an answer to a question, whatever the language."""
FIRST = tuple(one for one in TEXT if one not in ("previous answer", "one answer behind"))  # of the first answer of all
SOME = ("silence", "truncated", "garbage", "previous answer", "NaN", "flipped bit", "disconnect", "hung")
FEW = ("truncated", "previous answer", "flipped bit", "disconnect")

SAMPLES: Mapping[str, Spoilt] = {
    "silence": Spoilt("silence"), "late": Spoilt("late", size=LATE), "truncated": Spoilt("truncated"),
    "garbage": Spoilt("garbage"), "flipped bit": Spoilt("flipped", bit=3),
    "flipped bit before the check sum": Spoilt("inside", bit=7, place=71), "lost frame": Spoilt("lost"),
    "doubled frame": Spoilt("doubled"), "lost scan": Spoilt("lost_scans"), "doubled scan": Spoilt("doubled_scans"),
    "lost scan, not counted": Spoilt("hidden_loss"), "doubled scan, not counted": Spoilt("hidden_double"),
    "100 lost scans, not counted": Spoilt("hidden_loss", size=100), "lost conversion": Spoilt("slipped"),
    "disconnect": Spoilt("disconnect"), "hung": Spoilt("hung"),
}  # fmt: skip
"""Of the third frame of samples."""


@dataclass(frozen=True)
class Answers:
    """The answers of an instrument to a question, while a procedure goes on; `which` of the faults of text."""

    procedure: str
    instrument: str
    line: str
    asked: str
    skip: int = 0
    which: Sequence[str] = tuple(TEXT)

    def cells(self) -> Iterator[Cell]:
        for fault in self.which:
            spoilt = replace(TEXT[fault], asked=self.asked, skip=self.skip)
            yield Cell(self.procedure, self.instrument, fault, self.line, spoilt)


SERIAL = ("silence", "late", "truncated", "garbage", "disconnect", "hung")
CONTROL = (("rate", "CONF:RATE"), ("range", "CONF:RANG"), ("read-back", r"CONF\?"))
ANSWERS: Sequence[Answers] = (
    Answers("sweep", "vibrometer, identity", "ldv", "REM", which=FIRST),
    Answers("sweep", "vibrometer, range", "ldv", r"^VELO\?", 2),
    Answers("sweep", "vibrometer, level", "ldv", "LEV", 1),
    Answers("sweep", "vibrometer, over-range", "ldv", "OVR", which=SOME),
    Answers("sweep", "analyzer, identity", "gpib", r"^19:\*IDN", which=FIRST),
    Answers("sweep", "analyzer, status byte", "gpib", "^19:spoll", 3),
    Answers("sweep", "analyzer, input range", "gpib", r"^19:VOLT\d:RANG", 8),
    Answers("sweep", "analyzer, sine", "gpib", "^19:SOUR:VOLT:UNIT", 3),
    Answers("sweep", "analyzer, output", "gpib", "^19:OUTP", which=SOME),
    Answers("sweep", "analyzer, spectrum of the filter", "gpib", "^19:CALC1:DATA", which=SOME),
    Answers("sweep", "analyzer, spectrum", "gpib", "^19:CALC1:DATA", 3),
    Answers("sweep", "oscilloscope, identity", "gpib", r"^7:\*IDN", which=SERIAL),
    Answers("sweep by the oscilloscope", "oscilloscope, time base", "gpib", "^7::TIM", 1),
    Answers("sweep by the oscilloscope", "oscilloscope, range", "gpib", "^7::CHAN2:PROBE", 1),
    Answers("sweep by the oscilloscope", "oscilloscope, preamble", "gpib", "^7:.*PRE"),
    Answers("sweep by the oscilloscope", "oscilloscope, trace", "gpib", "^7::WAV:DATA"),
    Answers("sweep", "converter, identity", "daq", "IDN", which=FIRST),
    *(Answers("sweep", f"converter, {name}", "daq", asked, 1) for name, asked in CONTROL),
    Answers("sweep", "converter, start", "daq", "INIT", which=SOME),
    *(Answers(p, f"converter, {name}", "daq", asked, 1, FEW) for p in CONVERTER[1:] for name, asked in CONTROL),
    Answers("turntable", "converter, stop", "daq", "ABOR", which=SOME),
)  # fmt: skip

ANALYZER, SCOPE = b"HEWLETT-PACKARD,35670A,3046A00132,A.00.01\n", b"HEWLETT-PACKARD,54520A,0,01.00\n"
BOARD = b"OK Measurement Computing,PC104-DAS16JR/12,1,1.0\n"
NUMBERS: Sequence[tuple[str, str, str, str, str, float, int]] = (  # procedure … asked, times, which number
    ("sweep", "analyzer, input range", "told 1.5 times", "gpib", r"^19:VOLT\d:RANG", 1.5, 0),
    ("sweep", "analyzer, sine", "frequency told 1 % higher", "gpib", "^19:SOUR:VOLT:UNIT", 1.01, 0),
    ("sweep", "analyzer, sine", "level told half", "gpib", "^19:SOUR:VOLT:UNIT", 0.5, 1),
    (
        "sweep by the oscilloscope",
        "oscilloscope, preamble",
        "1.1 times the volts in one channel",
        "gpib",
        "CHAN2;PRE",
        1.1,
        7,
    ),
    (
        "sweep by the oscilloscope",
        "oscilloscope, preamble",
        "1.03 times the volts in one channel",
        "gpib",
        "CHAN2;PRE",
        1.03,
        7,
    ),
    (
        "sweep by the oscilloscope",
        "oscilloscope, preamble",
        "twice the volts of the reference",
        "gpib",
        "CHAN1;PRE",
        2.0,
        7,
    ),
    ("sweep by the oscilloscope", "oscilloscope, preamble", "1.03 times the time", "gpib", r"^7:.*PRE", 1.03, 4),
    ("sweep by the oscilloscope", "oscilloscope, preamble", "twice the time", "gpib", r"^7:.*PRE", 2.0, 4),
    ("sweep by the oscilloscope", "oscilloscope, range", "told twice", "gpib", "^7::CHAN2:PROBE", 2.0, 0),
    *((p, "converter, rate", "told 1 % slower", "daq", "CONF:RATE", 1.01, 0) for p in CONVERTER),
    *(
        (p, "converter, rate", "told 1 % slower and read back so", "daq", r"CONF:RATE|CONF\?", 1.01, -1)
        for p in CONVERTER
    ),
)
INDEX = 8 * 200 + 1  # in a spectrum: the byte below the sign and most of the exponent, at 500 Hz
OTHERS: Sequence[Cell] = (
    *(Cell(p, instrument, fault, line, Spoilt("number", asked, size=times, place=which, lasting=True))
      for p, instrument, fault, line, asked, times, which in NUMBERS),
    *(Cell(p, "converter, range", f"told ±{volts} V", "daq",
           Spoilt("other", "CONF:RANG", says=f"OK -{volts},{volts}\n".encode(), lasting=True))
      for p in CONVERTER for volts in (5, 20)),
    Cell("sweep", "analyzer, identity", "wrong identity", "gpib", Spoilt("other", r"^19:\*IDN", says=ANALYZER)),
    Cell("sweep", "oscilloscope, identity", "wrong identity", "gpib", Spoilt("other", r"^7:\*IDN", says=SCOPE)),
    Cell("sweep", "vibrometer, identity", "wrong identity", "ldv", Spoilt("other", "REM", says=b"OFV-5000\n")),
    *(Cell(p, "converter, identity", "wrong identity", "daq", Spoilt("other", "IDN", says=BOARD)) for p in CONVERTER),
    Cell("sweep", "vibrometer, range", "another range is told", "ldv",
         Spoilt("other", r"^VELO\?", 2, says=b"3\n", lasting=True)),
    Cell("sweep", "vibrometer, range", "another range is told from the second point on", "ldv",
         Spoilt("other", r"^VELO\?", 8, says=b"3\n", lasting=True)),
    Cell("sweep", "analyzer, spectrum", "1.1 times as large", "gpib", Spoilt("scaled", "^19:CALC[12]:DATA", 6, 1.1)),
    Cell("sweep", "analyzer, spectrum", "half as large", "gpib", Spoilt("scaled", "^19:CALC[12]:DATA", 6, 0.5)),
    Cell("sweep", "analyzer, spectrum", "flipped bit at the frequency", "gpib",
         Spoilt("flipped", "^19:CALC[12]:DATA", 6, bit=4, place=INDEX, lasting=True)),
    Cell("sweep", "analyzer, spectrum", "small flipped bit at the frequency", "gpib",
         Spoilt("flipped", "^19:CALC[12]:DATA", 6, bit=3, place=INDEX, lasting=True)),
    Cell("sweep", "analyzer, status byte", "always done", "gpib",
         Spoilt("other", "^19:spoll", 3, says=b"32\r\n", lasting=True)),
    Cell("sweep", "analyzer", "input 1 overloaded", plants={"hp89410a.overload": 1}),
    Cell("sweep", "oscilloscope", "no trigger", plants={"hp54542a.no_trigger": True}),
    Cell("sweep by the oscilloscope", "oscilloscope", "no trigger", plants={"hp54542a.no_trigger": True}),
    Cell("sweep", "vibrometer", "over range", plants={"ofv3001.overrange": True}),
    Cell("sweep", "vibrometer", "low level", plants={"ofv3001.low_level": True}),
    Cell("sweep", "vibrometer", "deaf to settings", plants={"ofv3001.deaf": True}),
    Cell("sweep", "gateway", "hung from the start", "gpib", Spoilt("hung", "")),
    Cell("sweep", "gateway", "hung while driving", "gpib", Spoilt("hung", "", 60)),
    Cell("sweep", "gateway", "disconnect while driving", "gpib", Spoilt("disconnect", "", 60)),
    Cell("sweep", "gateway", "silent to one instrument", plants={"gpib.silence": 7}),
    Cell("sweep", "gateway", "late", plants={"gpib.late": 19}),
    Cell("sweep", "gateway", "block cut off", plants={"gpib.truncate": 100}),
    Cell("sweep", "second client", "changes the level", "gpib",
         Spoilt("second_client", "^19:SOUR:VOLT:UNIT", 4, says=b"++addr 19\nSOUR:VOLT 0.3 VPK\n")),
    Cell("sweep", "second client", "switches the source off", "gpib",
         Spoilt("second_client", "^19:CALC1:DATA", 3, says=b"++addr 19\nOUTP OFF\n")),
    Cell("sweep", "second client", "sets an input range", "gpib",
         Spoilt("second_client", "^19:SOUR:VOLT:UNIT", 4, says=b"++addr 19\nVOLT2:RANG -20 DBM\n")),
    Cell("sweep", "second client", "sets the vibrometer's range", "ldv",
         Spoilt("second_client", "^LEV", 2, says=b"REN\nVELO4\n")),
    Cell("sweep", "second client", "asks the vibrometer", "ldv", Spoilt("second_client", "^LEV", 2, says=b"VELO?\n")),
    *(Cell(p, "second client", f"says {says.decode()} to the converter", "daq",
           Spoilt("second_client", "INIT", says=says + b"\n"))
      for p in CONVERTER for says in (b"ABOR", b"CONF:RATE 1000")),
    *(Cell(p, "converter, data", f"metadata {fault}", "data", replace(SAMPLES[fault], asked="metadata"))
      for p in ("sweep", "turntable") for fault in ("lost frame", "doubled frame", "garbage", "truncated")),
    *(Cell(p, "converter, data", fault, "data", replace(one, asked="samples", skip=2))
      for p in CONVERTER for fault, one in SAMPLES.items()),
    *(Cell(p, "converter", f"{fault} by the twin", plants=plant) for p in CONVERTER for fault, plant in {
        "buffer overflow": {"das16jr.overflow": 500}, "lost conversion of slot 0": {"das16jr.slip": [700, 0]},
        "corrupt frame": {"das16jr.corrupt": True}}.items()),
    *(Cell("sweep", "vibrometer, terminal", fault, "ldv", replace(TEXT[fault], asked=r"^VELO\?", skip=2), pty=True)
      for fault in SERIAL),
)  # fmt: skip

CLOCKS = (0.99, 0.995, 0.998, 1.002, 1.005, 1.01, 1.019, 1.05, 1.5, 2.0, 10.0)
CUBE: Mapping[str, tuple[Spoilt | None, Mapping[str, Any]]] = {
    **{f"identity: {fault}": (replace(TEXT[fault], asked="90"), {}) for fault in SERIAL},
    **{f"samples: {fault}": (replace(TEXT[fault], asked="01", skip=200), {})
       for fault in (*SERIAL, "duplicated", "flipped bit", "previous answer")},
    "samples: lost": (Spoilt("lost", "01", 200), {}),
    "mute": (None, {"sensor_cube.mute": True}),
    "restarts": (None, {"sensor_cube.restart": True}),
    "1 byte of 1000 wrong": (None, {"sensor_cube.byte_errors": 1e-3}),
    "1 byte of 1000 lost": (None, {"sensor_cube.drop_bytes": 1e-3}),
    "unplugged": (None, {"sensor_cube.disconnect": True}),
}  # fmt: skip

Channels = Mapping[str, tuple[str, ...]]
WHAT: Mapping[str, Any] = {
    "stuck": lambda name: Wrong(stuck={name: 1.7}), "dead": lambda name: Wrong(stuck={name: 0.0}),
    "at the rail": lambda name: Wrong(stuck={name: 10.0}),
    "inverted": lambda name: Wrong(inverted=frozenset({name})),
    "clipped": lambda name: Wrong(cut={name: CUT.get(name, (-10.0, 1.66))}),
    "spikes": lambda name: Wrong(spikes={name: (3, 0.5)}),
    "one large spike": lambda name: Wrong(spikes={name: (1, 5.0)}),
    "hanging bit": lambda name: Wrong(hanging={name: 1 << 5}), "loose contact": lambda name: Wrong(loose={name: 0.05}),
    "reads 10 % more": lambda name: Wrong(gain={name: 1.1}), "reads 2 % less": lambda name: Wrong(gain={name: 0.98}),
    "reads twice": lambda name: Wrong(gain={name: 2.0}), "reads a tenth": lambda name: Wrong(gain={name: 0.1}),
}  # fmt: skip
CUT = {"ldv": (-10.0, 1.0), "unit_c_x": (-10.0, 2.51), "gyro_yaw": (2.3, 10.0), "backup_yaw": (2.3, 10.0)}
"""Limits of what a clipped channel shows, V."""
ALL, STILL = tuple(WHAT), ("stuck", "dead", "at the rail", "hanging bit", "loose contact")
SENSOR = tuple(one for one in WHAT if not one.startswith("reads"))  # its own gain is what is measured
CHANNELS: Mapping[str, Channels] = {
    "sweep": {"ldv": ALL, "unit_a_x": SENSOR, "unit_b_x": ("stuck", "clipped", "inverted", "hanging bit"),
              "unit_c_x": ("dead", "clipped", "spikes", "loose contact"), "unit_a_y": ("stuck", "hanging bit"),
              "tag": ("stuck", "dead", "loose contact"), "supply": STILL, "temperature": STILL},
    "turntable": {"encoder_a": (*STILL, "inverted"), "encoder_b": (*STILL, "inverted"),
                  "encoder_index": (*STILL, "inverted"), "gyro_yaw": SENSOR,
                  "backup_yaw": ("stuck", "inverted", "hanging bit", "loose contact"),
                  "gyro_pitch": ("stuck", "loose contact"), "unit_a_x": ("stuck", "inverted", "loose contact"),
                  "tag": ("stuck", "dead"), "supply": ("dead", "stuck"), "temperature": ("dead", "stuck")},
    "tumble": {"unit_a_x": SENSOR, "unit_b_y": ("stuck", "inverted", "hanging bit", "loose contact"),
               "unit_c_z": ("dead", "inverted", "spikes", "loose contact"), "tag": ("stuck", "dead"),
               "supply": ("dead", "stuck"), "temperature": ("dead", "stuck")},
    "noise": {"unit_a_x": ("stuck", "dead", "at the rail", "clipped", "spikes", "one large spike", "hanging bit",
                           "loose contact"),
              "gyro_yaw": ("stuck", "spikes", "hanging bit", "loose contact"), "supply": ("dead", "stuck")},
    "sweep by the oscilloscope": {"ldv": ("inverted", "dead", "clipped", "reads 10 % more", "loose contact"),
                                  "unit_a_x": ("inverted", "stuck", "clipped", "spikes", "loose contact")},
    "tumble by the cube": {"unit_a_x": ("stuck", "inverted", "spikes", "loose contact"),
                           "unit_c_z": ("dead", "inverted")},
}  # fmt: skip
SWAPPED: Mapping[str, Sequence[tuple[str, str]]] = {
    "sweep": (("unit_a_x", "unit_a_y"), ("unit_a_x", "unit_b_x"), ("unit_a_x", "unit_c_x"), ("unit_a_y", "unit_a_z"),
              ("ldv", "unit_a_x"), ("ldv", "tag"), ("supply", "temperature"), ("unit_c_x", "gyro_pitch")),
    "turntable": (("encoder_a", "encoder_b"), ("encoder_a", "encoder_index"), ("encoder_b", "encoder_index"),
                  ("gyro_yaw", "backup_yaw"), ("gyro_yaw", "gyro_pitch"), ("unit_a_x", "unit_a_y"),
                  ("unit_a_x", "unit_a_z"), ("supply", "temperature"), ("tag", "quiet")),
    "tumble": (("unit_a_x", "unit_a_y"), ("unit_a_x", "unit_b_x"), ("unit_b_y", "unit_c_y"), ("tag", "unit_a_x"),
               ("supply", "temperature"), ("unit_c_x", "gyro_pitch")),
    "noise": (("unit_a_x", "unit_b_x"), ("unit_a_x", "unit_c_x"), ("unit_c_x", "gyro_pitch"),
              ("supply", "temperature")),
    "sweep by the oscilloscope": (("ldv", "unit_a_x"), ("unit_a_x", "unit_a_y")),
    "tumble by the cube": (("unit_a_x", "unit_a_y"), ("unit_b_x", "unit_b_z")),
}  # fmt: skip
COPIED: Mapping[str, Sequence[tuple[str, str]]] = {
    "sweep": (("unit_a_x", "unit_b_x"), ("unit_a_x", "ldv"), ("ldv", "unit_b_x"), ("unit_c_x", "unit_a_x")),
    "turntable": (("encoder_b", "encoder_a"), ("gyro_yaw", "backup_yaw"), ("encoder_index", "encoder_a")),
    "tumble": (("unit_a_x", "unit_a_y"), ("unit_b_x", "unit_a_x")),
    "noise": (("unit_a_x", "unit_a_y"),),
}  # fmt: skip


def _other(action: str, **settings: Any) -> Any:
    """A hand that sets something else when it is asked for one thing."""
    return lambda asked, told: told | settings if asked == action else told


def _nothing(action: str) -> Any:
    """A hand that says "done" and does nothing."""
    return lambda asked, told: None if asked == action else told


HANDS: Mapping[str, Mapping[str, Any]] = {
    "sweep": {
        "mounted along y": mounted(axis="y"), "mounted along z": mounted(axis="z"),
        "not mounted": _nothing("mount_on_shaker"), "dial at half the cut-off": _other("set_filter", cutoff=2500.0),
        "dial at 4.5 kHz": _other("set_filter", cutoff=4500.0), "dial at 100 Hz": _other("set_filter", cutoff=100.0),
        "filter bypassed": _other("set_filter", mode="bypass"), "filter at 20 dB": _other("set_filter", gain_db=20.0),
        "filter low-q": _other("set_filter", response="low-q"), "filter not set": _nothing("set_filter"),
        "filter still in the test": lambda asked, told: told if told.get("on", True) else None,
        "filter test not plugged": _nothing("filter_test"), "input 2 on unit B": _other("plug_analyzer", slot=5),
        "input 2 on the y axis": _other("plug_analyzer", slot=3), "input 2 not plugged": _nothing("plug_analyzer"),
        "turntable cables": _other("cables", set="turntable"), "beam not aligned": _nothing("align_beam"),
    },
    "turntable": {
        "upside down": mounted(inverted="not"), "another radius": mounted(radius=0.06),
        "half the radius": mounted(radius=0.025),
        "turned by 10°": mounted(angle=math.radians(10.0)), "turned by 90°": mounted(angle=math.pi / 2),
        "pitch for yaw": mounted(axis="pitch"), "roll for yaw": mounted(axis="roll"),
        "not mounted": _nothing("mount_on_turntable"), "shaker cables": _other("cables", set="shaker"),
        "33 rpm for 45": lambda asked, told: told | {"rpm": 100 / 3} if told.get("rpm") else told,
        "never started": lambda asked, told: None if asked == "turntable_speed" and told["rpm"] else told,
        "never stopped": lambda asked, told: None if asked == "turntable_speed" and not told["rpm"] else told,
    },
    "tumble": {
        "a pose skipped": Poses(lambda n, up, last: last if n == 2 else up),
        "a pose negated": Poses(lambda n, up, last: -up if n == 3 else up),
        "all poses negated": Poses(lambda n, up, last: -up),
        "a pose tilted by 20°": Poses(lambda n, up, last: turned(up, 20.0) if n == 1 else up),
        "a pose tilted by 5°": Poses(lambda n, up, last: turned(up, 5.0) if n == 1 else up),
        "a pose tilted by 1°": Poses(lambda n, up, last: turned(up, 1.0) if n == 1 else up),
        "all poses turned by 90°": Poses(lambda n, up, last: turned(up, 90.0)),
        "all poses tilted by 10°": Poses(lambda n, up, last: turned(up, 10.0)),
        "never moved": _nothing("pose"), "turntable cables": _other("cables", set="turntable"),
    },
    "noise": {"turntable cables": _other("cables", set="turntable")},
    "tumble by the cube": {
        "a pose skipped": Poses(lambda n, up, last: last if n == 2 else up),
        "a pose negated": Poses(lambda n, up, last: -up if n == 3 else up),
        "all poses turned by 90°": Poses(lambda n, up, last: turned(up, 90.0)),
    },
}  # fmt: skip
REFERENCE = {"1 % more": 1.01, "5 % more": 1.05, "5 times": 5.0, "a fifth": 0.2}  # than its range says


def cells() -> Iterator[Cell]:
    """All of them; the clean ones first, against which the others are held."""
    for procedure in PROCEDURES:
        yield Cell(procedure, "-", "none")
    for block in ANSWERS:
        yield from block.cells()
    yield from OTHERS
    for fault, (spoilt, plants) in CUBE.items():
        yield Cell("tumble by the cube", "cube", fault, "cube", spoilt, plants=plants)
    for procedure in CONVERTER:
        for factor in CLOCKS:
            yield Cell(procedure, "converter, clock", f"× {factor:g}", plants={"das16jr.clock": factor})
    yield from _of_the_bench()


def _of_the_bench() -> Iterator[Cell]:
    for procedure, channels in CHANNELS.items():
        for name, faults in channels.items():
            for fault in faults:
                yield Cell(procedure, f"channel {name}", fault, wrong=WHAT[fault](name))
    for procedure, pairs in SWAPPED.items():
        for pair in pairs:
            yield Cell(procedure, "cables", f"{pair[0]} and {pair[1]} swapped", wrong=Wrong(swapped=pair))
    for procedure, pairs in COPIED.items():
        for name, seen in pairs:
            yield Cell(procedure, "cables", f"{name} sees {seen}", wrong=Wrong(copied={name: seen}))
    for procedure, hands in HANDS.items():
        for fault, told in hands.items():
            yield Cell(procedure, "operator", fault, wrong=Wrong(told=told))
    for procedure in ("sweep", "sweep by the oscilloscope"):
        for fault, gain in REFERENCE.items():
            yield Cell(procedure, "vibrometer, scale", f"{fault} than told", wrong=Wrong(gain={"ldv": gain}))
        for factor in (0.5, 2.0):
            yield Cell(procedure, "source, level", f"{factor:g} times what was set", wrong=Wrong(drive=factor))
    for procedure in ("sweep", "turntable", "tumble"):
        yield Cell(procedure, "operator", "refuses", plants={"operator.refuses": True})
