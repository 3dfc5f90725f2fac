"""HP 89410A vector signal analyzer: the bench's sine source, and the two-channel analyzer beside it.

Command set and status model: Agilent 89400-Series GPIB Command Reference (89400-90039). The source level is always sent
with its unit, because a bare number means dBm; it is the peak voltage across 50 Ω, so a high-impedance amplifier sees
twice as much. N averages are really waited for: `INIT:CONT OFF; INIT` completes after one scan even with averaging on,
so a measurement is `INIT:CONT ON`, `AVER:TCON NORM`, `ABOR` and `*OPC`, and then the serial poll. `*OPC?` is never
used for it: behind a Prologix adapter a reply must begin within three seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from drivers.links import VisaLink
from rig.errors import BadReply, InstrumentError, NoAnswer, SettingRefused, WrongIdentity
from rig.record import Identity, Response, Traces
from rig.room import Room
from rig.units import Time

POINTS = (51, 101, 201, 401, 801, 1601, 3201)
MOST_SOURCE = 5.0  # V peak into 50 Ω, sine (89441A Technical Data, baseband section)
HIGHEST = 10e6  # Hz
RANGE_LOWEST, RANGE_HIGHEST, RANGE_STEP = -30.0, 28.0, 2.0  # dBm referred to 50 Ω, 1 MΩ inputs
EVENT_SUMMARY = 32  # status byte bit 5
POLL = 0.05  # s on the bench's clock
ERRORS_AT_MOST = 25  # the instrument's queue holds 20

OVER_RANGE = {0: "input 1 over range", 1: "input 2 over range", 7: "input 1 converter", 8: "input 2 converter"}
TRIPPED = {4: "input 1 relay tripped", 5: "input 2 relay tripped", 6: "source relay tripped"}

RATIO = "XFR:POW:RAT 2,1"
COHERENCE = "XFR:POW:COH:2,1"

SETUP = (
    "INST:SEL VECT",
    "INP1:STAT ON;:INP2:STAT ON",
    "INP1:COUP DC;:INP2:COUP DC",
    "INP1:IMP 1000000;:INP2:IMP 1000000",
    "CAL:AUTO OFF",
    "FORM REAL,64",
    "AVER:TYPE RMS;TCON NORM",
    "TRIG:SOUR IMM",
    "*CLS;*ESE 1;*SRE 32",
)

MESSAGES: tuple[str, ...] = (
    "*IDN?",
    "SYST:PRES",
    *SETUP,
    "SWE:POIN 401;:FREQ:STAR 0 HZ;STOP 1000 HZ;:WIND FLAT",
    "AVER:STAT ON;COUN 4",
    f"CALC1:FEED '{RATIO}';FORM REAL",
    f"CALC2:FEED '{RATIO}';FORM IMAG",
    f"CALC3:FEED '{COHERENCE}';FORM MLIN",
    "CALC1:FEED 'XTIM:VOLT 1';FORM REAL",
    "CALC2:FEED 'XTIM:VOLT 2';FORM REAL",
    "SOUR:FUNC SIN",
    "SOUR:FREQ 100 HZ;VOLT 0.1 VPK",
    "SOUR:FREQ?;VOLT?",
    "SOUR:VOLT:UNIT:VOLT VPK",
    "OUTP ON",
    "OUTP OFF",
    "OUTP?",
    "VOLT1:RANG -10 DBM",
    "VOLT1:RANG?",
    "VOLT1:RANG:AUTO ONCE;:VOLT2:RANG:AUTO ONCE",
    "STAT:OPER:COND?",
    "INIT:CONT ON;:ABOR;*OPC",
    "*ESR?",
    "AVER:COUN:INT?",
    "CALC1:DATA?",
    "CALC2:DATA?",
    "CALC3:DATA?",
    "STAT:QUES:VOLT:COND?",
    "FREQ:STOP?;:SWE:POIN?;:AVER:COUN?",
    "CAL:ZERO:AUTO ONCE",
    "SYST:ERR?",
)


class Settings(BaseModel):
    """Where the analyzer is. `gateway` is the adapter's VISA resource if there is one; `backend` the VISA library."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    address: str = Field(min_length=1)
    gateway: str | None = None
    timeout: Time = Field(default=3.0, gt=0, le=60)
    backend: str = "@py"


@dataclass
class _Set:
    """What was last set and read back, so that a point costs no more messages than it needs."""

    span: float = 0.0
    points: int = 0
    averages: int = 0
    frequency: float = math.nan
    amplitude: float = math.nan
    traces: str = ""


class HP89410A:
    """Source and analyzer. Input 1 is the reference, input 2 the sensor; the response is input 2 ÷ input 1."""

    def __init__(self, link: VisaLink, room: Room) -> None:
        self._link, self._room = link, room
        self._set = _Set()
        self._ranges: dict[int, float] = {}
        self._overloads: set[str] = set()

    def identify(self) -> Identity:
        """Raises WrongIdentity if anything but an 89410A answers."""
        reply = self._link.query("*IDN?")
        parts = [part.strip() for part in reply.split(",")]
        if len(parts) != 4 or parts[1] != "89410A":
            raise WrongIdentity(self._link.instrument, self._link.address, sent="*IDN?", received=reply, wanted="an 89410A")
        return Identity(*parts)

    def preset(self) -> None:
        """Instrument preset: the source is off, every setting is known. Raises SettingRefused."""
        self._link.write("SYST:PRES")
        for message in SETUP:
            self._link.write(message)
        self._link.write("SOUR:FUNC SIN")
        self._link.write("SOUR:VOLT:UNIT:VOLT VPK")
        self._set, self._ranges = _Set(), {}
        self._drain("SYST:PRES and set-up")

    def configure(self, *, span: float, points: int, averages: int) -> None:
        """Two-channel baseband measurement from 0 Hz to `span` (Hz), `points` lines, `averages` rms averages.

        Raises SettingRefused: beforehand for what the instrument cannot do (nothing is sent), afterwards for what it
        did not take.
        """
        if points not in POINTS:
            raise self._refused(f"one of {POINTS} points, found {points}")
        if not 1.0 <= span <= HIGHEST or not 1 <= averages <= 99_999:
            raise self._refused(f"a span of 1 Hz to 10 MHz and 1 to 99999 averages, found {span:g} Hz and {averages}")
        # Start first: the centre must never be set, or the analyzer leaves baseband for zoom.
        self._link.write(f"SWE:POIN {points};:FREQ:STAR 0 HZ;STOP {span:.9g} HZ;:WIND FLAT")
        self._link.write(f"AVER:STAT ON;COUN {averages}")
        self._drain("the measurement set-up")
        self._set.span, self._set.points, self._set.averages, self._set.traces = span, points, averages, ""
        found = self._link.query("FREQ:STOP?;:SWE:POIN?;:AVER:COUN?")
        if _numbers(found, self._link) != (span, points, averages):
            raise self._refused(f"span {span:g} Hz, {points} points, {averages} averages", received=found)

    def set_sine(self, frequency: float, amplitude: float) -> None:
        """Sine of `frequency` (Hz) and `amplitude` (V peak into 50 Ω); the output stays on or off as it is.

        Raises SettingRefused: beforehand (nothing is sent) if out of range, afterwards if read back differently.
        """
        if not 0.0 < frequency <= HIGHEST:
            raise self._refused(f"a frequency above 0 and up to 10 MHz, found {frequency:g} Hz")
        if not 0.0 <= amplitude <= MOST_SOURCE:
            raise self._refused(f"an amplitude of 0 to {MOST_SOURCE:g} Vpk, found {amplitude:g}")
        message = f"SOUR:FREQ {frequency:.10g} HZ;VOLT {amplitude:.8g} VPK"
        self._link.write(message)
        found = self._link.query("SOUR:FREQ?;VOLT?")
        values = _numbers(found, self._link)
        if len(values) != 2 or abs(values[0] - frequency) > 1e-4 or abs(values[1] - amplitude) > 1e-4 + 1e-3 * amplitude:
            self._drain(message)
            raise self._refused(f"{frequency:g} Hz and {amplitude:g} Vpk", sent=message, received=found)
        self._set.frequency, self._set.amplitude = frequency, amplitude

    def output(self, on: bool) -> None:
        """Switch the source's output, and read back that it did."""
        message = f"OUTP {'ON' if on else 'OFF'}"
        self._link.write(message)
        found = self._link.query("OUTP?")
        if found.lstrip("+") != str(int(on)):
            raise self._refused(f"output {'on' if on else 'off'}", sent=message, received=found)

    def make_safe(self) -> None:
        """The source off, first of all; works on a fresh connection at any moment. Raises InstrumentError."""
        self._link.write("OUTP OFF")
        try:
            confirmed = self._link.query("OUTP?").lstrip("+") == "0"
        except BadReply:  # the rest of an exchange that was broken off
            confirmed = self._link.query("OUTP?").lstrip("+") == "0"
        if not confirmed:
            raise self._refused("output off", sent="OUTP OFF")

    def set_range(self, channel: int, volts: float) -> float:
        """Smallest input range that holds `volts` (peak); the range really set is returned, V peak."""
        if channel not in (1, 2) or not volts > 0:
            raise self._refused(f"input 1 or 2 and a voltage above zero, found input {channel} and {volts:g} V")
        wanted = 10.0 * math.log10(volts**2 / 0.1)  # 0 dBm is 0.1 V² peak across 50 Ω
        stepped = max(RANGE_LOWEST, math.ceil((wanted - RANGE_LOWEST) / RANGE_STEP - 1e-9) * RANGE_STEP + RANGE_LOWEST)
        if stepped > RANGE_HIGHEST:
            raise self._refused(f"at most {_peak(RANGE_HIGHEST):.2f} V at an input, found {volts:g} V")
        if self._ranges.get(channel) != stepped:
            self._link.write(f"VOLT{channel}:RANG {stepped:g} DBM")
            self._drain(f"VOLT{channel}:RANG {stepped:g} DBM")
            self._ranges[channel] = stepped
        return _peak(stepped)

    def autorange(self, patience: float = 30.0) -> None:
        """Let both inputs find their range once; waits on the bench's clock. Raises NoAnswer."""
        self._link.write("VOLT1:RANG:AUTO ONCE;:VOLT2:RANG:AUTO ONCE")
        self._ranges = {}
        for _ in range(math.ceil(patience / POLL)):
            self._room.clock.sleep(POLL)
            if not int(float(self._link.query("STAT:OPER:COND?"))) & 4:
                return
        raise NoAnswer(self._link.instrument, self._link.address, sent="VOLT1:RANG:AUTO ONCE", wanted="ranging to end")

    def start_measurement(self) -> None:
        """Begin N averages of the frequency response; returns at once."""
        self._feed("response")
        self._begin()

    def finish_measurement(self, patience: float | None = None) -> Response:
        """Wait for the averages, then read the response.

        `patience` (s, bench clock) defaults to five times what the averages should take, and ten seconds.
        Raises NoAnswer if they are not done by then, BadReply for traces of the wrong length.
        """
        self._wait(patience)
        averages = int(float(self._link.query("AVER:COUN:INT?")))
        real, imaginary, coherence = (self._trace(number) for number in (1, 2, 3))
        return Response(
            frequency=np.linspace(0.0, self._set.span, self._set.points),
            ratio=real + 1j * imaginary,
            coherence=coherence,
            averages=averages,
            overloads=tuple(sorted(self._overloads | set(self.overloads()))),
        )

    def measure(self, patience: float | None = None) -> Response:
        """One whole measurement of the frequency response."""
        self.start_measurement()
        return self.finish_measurement(patience)

    def time_traces(self) -> Traces:
        """The two inputs as they were sampled in one record, V, at 2.56 × span."""
        self._feed("time")
        self._begin()
        self._wait(None)
        first, second = self._values(1), self._values(2)
        return Traces(("input_1", "input_2"), np.vstack([first, second]), 0.0, 1.0 / (2.56 * self._set.span))

    def overloads(self) -> tuple[str, ...]:
        """Inputs over their range or tripped since the last look; reading clears the register."""
        bits = int(float(self._link.query("STAT:QUES:VOLT:COND?")))
        return tuple(text for bit, text in {**OVER_RANGE, **TRIPPED}.items() if bits >> bit & 1)

    def errors(self) -> list[str]:
        """Everything in the error queue, oldest first; the queue is empty afterwards."""
        found: list[str] = []
        for _ in range(ERRORS_AT_MOST):
            reply = self._link.query("SYST:ERR?")
            try:
                code = int(reply.split(",", 1)[0])
            except ValueError as error:
                raise BadReply(
                    self._link.instrument, self._link.address, sent="SYST:ERR?", received=reply, wanted="a number and a text"
                ) from error
            if code == 0:
                return found
            found.append(reply)
        return found

    def zero(self) -> None:
        """Zero calibration now, at a moment of our choosing; automatic calibration is off."""
        self._link.write("CAL:ZERO:AUTO ONCE")
        self._drain("CAL:ZERO:AUTO ONCE")

    def settings(self) -> dict[str, str | float | int | bool]:
        """Read back from the instrument; SI, volts peak into 50 Ω."""
        frequency, level = _numbers(self._link.query("SOUR:FREQ?;VOLT?"), self._link)
        span, points, averages = _numbers(self._link.query("FREQ:STOP?;:SWE:POIN?;:AVER:COUN?"), self._link)
        output = self._link.query("OUTP?").lstrip("+") == "1"
        found: dict[str, str | float | int | bool] = {"source_frequency": frequency, "source_level": level, "output": output}
        found |= {"span": span, "points": int(points), "averages": int(averages)}
        return found | {f"range_{channel}_dbm": value for channel, value in sorted(self._ranges.items())}

    def close(self) -> None:
        """Close the link; the instrument keeps its state."""
        self._link.close()

    def _feed(self, what: str) -> None:
        if self._set.traces == what:
            return
        if what == "response":
            self._link.write(f"CALC1:FEED '{RATIO}';FORM REAL")
            self._link.write(f"CALC2:FEED '{RATIO}';FORM IMAG")
            self._link.write(f"CALC3:FEED '{COHERENCE}';FORM MLIN")
        else:
            self._link.write("CALC1:FEED 'XTIM:VOLT 1';FORM REAL")
            self._link.write("CALC2:FEED 'XTIM:VOLT 2';FORM REAL")
        self._drain(f"traces for {what}")
        self._set.traces = what

    def _begin(self) -> None:
        self._overloads = set()
        self.overloads()  # what was over range before does not count
        self._link.query("*ESR?")  # an old completion must not end the new wait
        self._link.write("INIT:CONT ON;:ABOR;*OPC")

    def _wait(self, patience: float | None) -> None:
        record = (self._set.points - 1) / self._set.span
        expected = record * self._set.averages
        waited, most = 0.0, 5.0 * expected + 10.0 if patience is None else patience
        pause = max(POLL, expected)
        while waited < most:
            self._room.clock.sleep(pause)
            waited += pause
            if self._link.poll() & EVENT_SUMMARY:
                return
            pause = POLL
        raise NoAnswer(
            self._link.instrument, self._link.address, sent="INIT:CONT ON;:ABOR;*OPC",
            wanted=f"{self._set.averages} averages within {most:.1f} s",
        )

    def _trace(self, number: int) -> NDArray[np.float64]:
        values = self._values(number)
        if len(values) != self._set.points:
            raise BadReply(
                self._link.instrument, self._link.address, sent=f"CALC{number}:DATA?",
                received=f"{len(values)} values", wanted=f"{self._set.points} values",
            )
        return values

    def _values(self, number: int) -> NDArray[np.float64]:
        """Big-endian doubles (GPIB Command Reference, FORMat)."""
        payload = self._link.query_block(f"CALC{number}:DATA?")
        if len(payload) % 8:
            raise BadReply(
                self._link.instrument, self._link.address, sent=f"CALC{number}:DATA?",
                received=f"{len(payload)} bytes", wanted="a block of 64-bit reals",
            )
        return np.frombuffer(payload, ">f8").astype(np.float64)

    def _drain(self, what: str) -> None:
        found = self.errors()
        if found:
            raise self._refused("no error", sent=what, received="; ".join(found))

    def _refused(self, wanted: str, sent: str | None = None, received: str | None = None) -> InstrumentError:
        return SettingRefused(self._link.instrument, self._link.address, sent=sent, received=received, wanted=wanted)


def _peak(dbm: float) -> float:
    """Peak volts across 50 Ω."""
    return math.sqrt(0.1 * 10.0 ** (dbm / 10.0))


def _numbers(reply: str, link: VisaLink) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in reply.split(";"))
    except ValueError as error:
        raise BadReply(link.instrument, link.address, received=reply, wanted="numbers joined by ';'") from error


def connect(name: str, settings: Settings, room: Room) -> HP89410A:
    """Open the link; nothing is sent to the analyzer."""
    link = VisaLink.open(
        name, settings.address, gateway=settings.gateway, timeout=settings.timeout, room=room, backend=settings.backend
    )
    return HP89410A(link, room)
