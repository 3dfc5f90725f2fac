"""HP 89410A vector signal analyzer: the bench's sine source, and the two-channel analyzer beside it.

Command set, limits and status model: Agilent 89400-Series GPIB Command Reference (89400-90039, firmware A.08) and HP
89441A Technical Data. Three of its habits shape this driver:

- a source level without a unit is dBm, so the unit is always sent (`VPK`); it is the peak voltage across 50 Ω, and an
  amplifier of high input impedance sees about twice as much;
- `INIT:CONT OFF; INIT` is complete after one scan even while averaging, so N averages are `INIT:CONT ON`,
  `AVER:TCON NORM`, `ABOR`, `*OPC`, and then the serial poll. `*OPC?` is never used: behind a Prologix adapter a reply
  must begin within three seconds;
- presets are AC coupling, 50 Ω and exponential averaging; all three are wrong here and are set.

A setting goes out together with its read-back and the error queue in one message, because every GPIB message costs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal

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
SOURCE_STEP = 25e-6  # Hz, resolution of the source
LOWEST_RANGE, RANGE_STEP = -30.0, 2.0  # dBm referred to 50 Ω
HIGHEST_RANGE = {50: 24.0, 1_000_000: 28.0}  # dBm by input impedance, Ω
DBM_REFERENCE = 0.1  # V² peak across 50 Ω at 0 dBm
EVENT_SUMMARY = 32  # status byte, bit 5
CALIBRATING, RANGING = 1, 4  # operation condition, bits 0 and 2
POLL = 0.02  # s on the bench's clock
ERRORS_AT_MOST = 25  # the queue holds 20

OVERLOADS = (
    (0b0_1000_0001, "input 1"),  # over range, or its converter
    (0b1_0000_0010, "input 2"),
    (0b0_0001_0000, "input 1 relay tripped"),
    (0b0_0010_0000, "input 2 relay tripped"),
    (0b0_0100_0000, "source relay tripped"),
)

Window = Literal["UNIF", "FLAT", "HANN", "GTOP"]
RATIO = "XFR:POW:RAT 2,1"
COHERENCE = "XFR:POW:COH:2,1"  # as the manual's vector column prints it (inferred: verify on the bench)

PRESET = "SYST:PRES"
CHECK = ";:SYST:ERR?"
SETUP = (
    f"INST:SEL VECT;:STAT:PRES;:CAL:AUTO OFF;:CAL:ZERO:AUTO OFF;:FORM REAL,64;:TRIG:SOUR IMM;:ARM:SOUR IMM{CHECK}",
    f"SOUR:FUNC SIN;VOLT:OFFS 0 V;UNIT:VOLT VPK;:VOLT1:RANG:UNIT:VOLT DBM;:VOLT2:RANG:UNIT:VOLT DBM{CHECK}",
)
INPUTS = "INP1:STAT ON;COUP {coupling};IMP {impedance};:INP2:STAT ON;COUP {coupling};IMP {impedance}" + CHECK
BAND = "SWE:POIN {points};:FREQ:BAS ON;STAR 0 HZ;STOP {span:.9g} HZ;:WIND {window};:BAND:MODE:ARB ON;:BAND:AUTO ON"
AVERAGING = "AVER:TYPE RMS;TCON NORM;COUN {averages};:AVER:STAT ON"
BAND_BACK = ";:FREQ:BAS?;STAR?;STOP?;:SWE:POIN?;:AVER:COUN?"
RESPONSE_FEED = (
    f"CALC1:FEED '{RATIO}';FORM REAL;:CALC2:FEED '{RATIO}';FORM IMAG;:CALC3:FEED '{COHERENCE}';FORM MLIN{CHECK}"
)
TIME_FEED = f"CALC1:FEED 'XTIM:VOLT 1';FORM REAL;:CALC2:FEED 'XTIM:VOLT 2';FORM REAL{CHECK}"
SINE = "SOUR:VOLT:UNIT:VOLT VPK;:SOUR:FUNC SIN;FREQ {frequency:.12g} HZ;VOLT {amplitude:.9g} VPK;FREQ?;VOLT?" + CHECK
OUTPUT = "OUTP {state};:OUTP?" + CHECK
RANGE = "VOLT{channel}:RANG {dbm:g} DBM;RANG?" + CHECK
AUTORANGE = "VOLT1:RANG:AUTO ONCE;:VOLT2:RANG:AUTO ONCE" + CHECK
ZERO = "CAL:ZERO:AUTO ONCE"
CONDITION = "STAT:OPER:COND?"
LATCHED = "STAT:QUES:VOLT:COND?;EVEN?"  # the condition is cleared by reading it, unlike any other
RUN_AVERAGES = LATCHED + ";*ESR?;*ESE 1;:AVER:STAT ON;:INIT:CONT ON;:ABOR;*OPC"
RUN_ONCE = LATCHED + ";*ESR?;*ESE 1;:AVER:STAT OFF;:INIT:CONT OFF;:INIT;*OPC"
RESULT = "AVER:COUN:INT?;:" + LATCHED + CHECK
SETTINGS_BACK = (
    ("mode", "INST:SEL?", str),
    ("start", "FREQ:STAR?", float),
    ("stop", "FREQ:STOP?", float),
    ("points", "SWE:POIN?", int),
    ("window", "WIND?", str),
    ("averaging", "AVER:TYPE?", str),
    ("averages", "AVER:COUN?", int),
    ("input_1_coupling", "INP1:COUP?", str),
    ("input_2_coupling", "INP2:COUP?", str),
    ("input_1_range_dbm", "VOLT1:RANG?", float),
    ("input_2_range_dbm", "VOLT2:RANG?", float),
    ("source_shape", "SOUR:FUNC?", str),
    ("source_frequency", "SOUR:FREQ?", float),
    ("source_level", "SOUR:VOLT?", float),
    ("source_level_unit", "SOUR:VOLT:UNIT:VOLT?", str),
    ("output", "OUTP?", bool),
    ("calibration_auto", "CAL:AUTO?", bool),
)
SETTINGS_QUERY = ";:".join(query for _, query, _ in SETTINGS_BACK)

MESSAGES: tuple[str, ...] = (
    "*IDN?",
    "*OPT?",
    "SYST:ERR?",
    "OUTP OFF",
    "OUTP?",
    "OUTP OFF;:OUTP?",
    "*CLS",
    f"*ESR?;*ESE 1;:{PRESET};*OPC",
    *SETUP,
    INPUTS.format(coupling="DC", impedance=1_000_000),
    f"{BAND.format(points=401, span=1000.0, window='FLAT')};:{AVERAGING.format(averages=4)}{BAND_BACK}{CHECK}",
    RESPONSE_FEED,
    RANGE.format(channel=1, dbm=10),
    RANGE.format(channel=2, dbm=10),
    SINE.format(frequency=100.0, amplitude=0.1),
    OUTPUT.format(state="ON"),
    AUTORANGE,
    CONDITION,
    RUN_AVERAGES,
    RESULT,
    "CALC1:DATA?",
    "CALC2:DATA?",
    "CALC3:DATA?",
    TIME_FEED,
    RUN_ONCE,
    LATCHED,
    f"*ESR?;*ESE 1;:{ZERO};*OPC",
    SETTINGS_QUERY,
    OUTPUT.format(state="OFF"),
)
"""Every message, in an order in which the instrument takes all of them."""


class Settings(BaseModel):
    """Where the analyzer is. `gateway` is the adapter's VISA resource if there is one; `backend` the VISA library."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    address: str = Field(min_length=1)
    gateway: str | None = None
    timeout: Time = Field(default=3.0, gt=0, le=60)
    backend: str = "@py"


class HP89410A:
    """Source and analyzer. Input 1 is the reference, input 2 the sensor; the response is input 2 ÷ input 1."""

    def __init__(self, link: VisaLink, room: Room) -> None:
        self._link, self._room = link, room
        self._span, self._points, self._averages = 0.0, 0, 0
        self._impedance = 1_000_000
        self._ranges: dict[int, float] = {}  # dBm, as read back
        self._fed = ""  # the feed message in force
        self._started = 0.0  # bench clock, s
        self._expected = 0.0  # how long the measurement under way should take, s

    def identify(self) -> Identity:
        """Raises WrongIdentity if anything but an 89410A with a second input channel (option AY7) answers."""
        reply = self._link.query("*IDN?")
        parts = [part.strip() for part in reply.split(",")]
        if len(parts) != 4 or parts[1] != "89410A":
            raise self._error(WrongIdentity, "an 89410A", "*IDN?", reply)
        options = self._link.query("*OPT?")
        if "AY7" not in options:
            raise self._error(WrongIdentity, "an 89410A with its second input channel (AY7)", "*OPT?", options)
        return Identity(*parts)

    def preset(self) -> None:
        """Instrument preset, source off, automatic calibration off, levels in Vpk. Raises SettingRefused, NoAnswer."""
        self._ranges, self._fed, self._points = {}, "", 0
        self._link.write("*CLS")  # errors from before are not those of the set-up
        self._complete(PRESET, patience=30.0)
        for message in SETUP:
            self._checked(message)

    def configure(
        self,
        *,
        span: float,
        points: int,
        averages: int,
        window: Window = "FLAT",
        coupling: Literal["DC", "AC"] = "DC",
        impedance: Literal[50, 1_000_000] = 1_000_000,
    ) -> None:
        """Two-channel vector measurement from 0 Hz to `span` (Hz): `points` lines, `averages` rms averages.

        A record lasts (points − 1)/span (arbitrary resolution bandwidth, coupled). Inputs are DC-coupled 1 MΩ.
        Raises SettingRefused: beforehand for what the instrument cannot do (nothing is sent), afterwards for what it
        did not take.
        """
        if points not in POINTS:
            raise self._refused(f"one of {POINTS} points, found {points}")
        if not 1.0 <= span <= HIGHEST or not 1 <= averages <= 99_999:
            raise self._refused(f"a span of 1 Hz to 10 MHz and 1 to 99999 averages, found {span:g} Hz and {averages}")
        self._checked(INPUTS.format(coupling=coupling, impedance=impedance))
        band = BAND.format(points=points, span=span, window=window)
        message = f"{band};:{AVERAGING.format(averages=averages)}{BAND_BACK}{CHECK}"
        found = self._checked_numbers(message, 5)
        if not np.allclose(found, (1, 0.0, span, points, averages), rtol=1e-6, atol=1e-9):
            raise self._refused(f"baseband from 0 to {span:g} Hz, {points} points, {averages} averages", message, found)
        self._span, self._points, self._averages, self._impedance = found[2], points, averages, impedance
        self._ranges, self._fed = {}, ""
        self._feed(RESPONSE_FEED)

    def set_sine(self, frequency: float, amplitude: float) -> None:
        """Sine of `frequency` (Hz) and `amplitude` (V peak into 50 Ω); the output stays on or off as it is.

        Raises SettingRefused: beforehand (nothing is sent) if out of range, afterwards if read back differently.
        """
        if not 0.0 < frequency <= HIGHEST:
            raise self._refused(f"a frequency above 0 and up to 10 MHz, found {frequency:g} Hz")
        if not 0.0 <= amplitude <= MOST_SOURCE:
            raise self._refused(f"an amplitude of 0 to {MOST_SOURCE:g} Vpk, found {amplitude:g}")
        message = SINE.format(frequency=frequency, amplitude=amplitude)
        found = self._checked_numbers(message, 2)
        # Frequency to the source's resolution, level to one per cent: it may be set in steps of a decibel scale.
        if abs(found[0] - frequency) > SOURCE_STEP or abs(found[1] - amplitude) > 1e-5 + 0.01 * amplitude:
            raise self._refused(f"{frequency:.10g} Hz and {amplitude:g} Vpk", message, found)

    def output(self, on: bool) -> None:
        """Switch the source's output, and read back that it did. Raises SettingRefused."""
        message = OUTPUT.format(state="ON" if on else "OFF")
        found = self._checked_numbers(message, 1)
        if found[0] != float(on):
            raise self._refused(f"the output {'on' if on else 'off'}", message, found)

    def make_safe(self) -> None:
        """The source off, before anything else; works on a fresh connection at any moment, and in bounded time.

        Raises InstrumentError if the instrument does not confirm it, also after a device clear.
        """
        self._link.write("OUTP OFF")
        try:
            found = self._link.query("OUTP?")
        except (NoAnswer, BadReply):
            # The rest of an exchange that somebody broke off; the link clears the instrument before it goes on.
            found = self._link.query("OUTP OFF;:OUTP?")
        if found.lstrip("+") != "0":
            raise self._refused("the output off", "OUTP OFF", found)

    def set_range(self, channel: int, volts: float) -> float:
        """Smallest range of an input that holds `volts` (peak); returns the range read back, V peak.

        Raises SettingRefused, beforehand (nothing is sent) if no range holds it.
        """
        if channel not in (1, 2) or not volts > 0.0:
            raise self._refused(f"input 1 or 2 and a voltage above zero, found input {channel} and {volts:g} V")
        dbm = max(LOWEST_RANGE, RANGE_STEP * math.ceil(10.0 * math.log10(volts**2 / DBM_REFERENCE) / RANGE_STEP - 1e-9))
        if dbm > HIGHEST_RANGE[self._impedance]:
            raise self._refused(f"at most {_peak(HIGHEST_RANGE[self._impedance]):.2f} V peak, found {volts:g} V")
        if self._ranges.get(channel) != dbm:
            message = RANGE.format(channel=channel, dbm=dbm)
            found = self._checked_numbers(message, 1)
            if abs(found[0] - dbm) > 0.1:
                raise self._refused(f"a range of {dbm:g} dBm", message, found)
            self._ranges[channel] = dbm
        return _peak(dbm)

    def autorange(self, patience: float = 30.0) -> None:
        """Let both inputs find their range once; waits on the bench's clock. Raises NoAnswer, SettingRefused."""
        self._ranges = {}
        self._checked(AUTORANGE)
        self._until_clear(RANGING, AUTORANGE, patience)

    def start_measurement(self) -> None:
        """Begin N averages of the frequency response; returns at once. Raises SettingRefused if never configured."""
        if not self._points:
            raise self._refused("a configured measurement")
        self._feed(RESPONSE_FEED)
        self._begin(RUN_AVERAGES, self._averages)

    def finish_measurement(self, patience: float | None = None) -> Response:
        """Wait for the averages, then read the response.

        `patience` (s, bench clock) defaults to five times what the averages should take, and ten seconds.
        `overloads` names the inputs that were over range since the measurement began.
        Raises NoAnswer if they are not done by then, BadReply for traces of a wrong length.
        """
        self._await_completion(RUN_AVERAGES, patience)
        averages, condition, event = self._checked_numbers(RESULT, 3)
        real, imaginary, coherence = (self._trace(number, self._points) for number in (1, 2, 3))
        return Response(
            # Resolution is span/(points − 1) (GPIB Command Reference, SWEep:POINts); `_span` was read back.
            frequency=np.linspace(0.0, self._span, self._points),
            ratio=real + 1j * imaginary,
            coherence=coherence,
            averages=int(averages),
            overloads=_named(int(condition) | int(event)),
        )

    def measure(self, patience: float | None = None) -> Response:
        """One whole measurement of the frequency response."""
        self.start_measurement()
        return self.finish_measurement(patience)

    def time_traces(self, patience: float | None = None) -> Traces:
        """Both inputs in one and the same record, V, sampled at 2.56 × span (Operator's Guide, baseband)."""
        if not self._points:
            raise self._refused("a configured measurement")
        self._feed(TIME_FEED)
        self._begin(RUN_ONCE, 1)  # one scan and then rest: a running measurement would move on between the two blocks
        self._await_completion(RUN_ONCE, patience)
        first = self._trace(1, None)
        second = self._trace(2, len(first))
        return Traces(("input_1", "input_2"), np.vstack([first, second]), 0.0, 1.0 / (2.56 * self._span))

    def overloads(self) -> tuple[str, ...]:
        """What is over range or tripped, or was since the last look; looking clears it."""
        condition, event = self._numbers(LATCHED, self._link.query(LATCHED).split(";"), 2)
        return _named(int(condition) | int(event))

    def errors(self) -> list[str]:
        """Everything in the error queue, oldest first; the queue is empty afterwards. Raises BadReply."""
        found: list[str] = []
        for _ in range(ERRORS_AT_MOST):
            reply = self._link.query("SYST:ERR?")
            if not self._error_code(reply):
                break
            found.append(reply)
        return found

    def zero(self, patience: float = 60.0) -> None:
        """Zero calibration now, at a moment of our choosing; about 2 mV appears at the source output meanwhile.

        Raises NoAnswer, SettingRefused with the instrument's errors.
        """
        self._complete(ZERO, patience)
        self._until_clear(CALIBRATING, ZERO, patience)
        self._raise_errors(ZERO)

    def settings(self) -> dict[str, str | float | int | bool]:
        """Read back from the instrument: Hz, dBm for ranges, the source level in its own unit (VPK after a preset)."""
        replies = self._link.query(SETTINGS_QUERY).split(";")
        if len(replies) != len(SETTINGS_BACK):
            raise self._error(BadReply, f"{len(SETTINGS_BACK)} values", SETTINGS_QUERY, ";".join(replies))
        try:
            return {key: _read(kind, reply) for (key, _, kind), reply in zip(SETTINGS_BACK, replies, strict=True)}
        except ValueError as error:
            raise self._error(BadReply, "numbers and words", SETTINGS_QUERY, ";".join(replies)) from error

    def close(self) -> None:
        """Close the link; the instrument keeps its state."""
        self._link.close()

    # what a message is made into

    def _feed(self, message: str) -> None:
        if self._fed != message:
            self._checked(message)
            self._fed = message

    def _begin(self, message: str, records: int) -> None:
        self._link.query(message)  # an old completion and old overloads are read away on the way
        self._started = self._room.clock.now()
        self._expected = records * (self._points - 1) / self._span

    def _complete(self, message: str, patience: float) -> None:
        """A command that takes its time, from sending it to the instrument's own word that it is done."""
        whole = f"*ESR?;*ESE 1;:{message};*OPC"
        self._link.query(whole)
        self._started, self._expected = self._room.clock.now(), 0.0
        self._await_completion(whole, patience)

    def _await_completion(self, sent: str, patience: float | None) -> None:
        most = 5.0 * self._expected + 10.0 if patience is None else patience
        while not self._link.poll() & EVENT_SUMMARY:
            waited = self._room.clock.now() - self._started
            if waited >= most:
                self._raise_errors(sent)
                state = self._link.query(CONDITION)
                raise self._error(NoAnswer, f"completion within {most:.1f} s (operation condition {state})", sent, None)
            self._room.clock.sleep(max(self._expected - waited, POLL))

    def _until_clear(self, bit: int, sent: str, patience: float) -> None:
        deadline = self._room.clock.now() + patience
        while int(self._numbers(CONDITION, [self._link.query(CONDITION)], 1)[0]) & bit:
            if self._room.clock.now() >= deadline:
                raise self._error(NoAnswer, f"completion within {patience:g} s", sent, None)
            self._room.clock.sleep(POLL)

    def _checked(self, message: str, count: int = 0) -> list[str]:
        """The replies to a message that ends with the question for errors. Raises SettingRefused naming them all."""
        replies = self._link.query(message).split(";", count)
        if len(replies) != count + 1:
            raise self._error(BadReply, f"{count} values and an error number", message, ";".join(replies))
        if self._error_code(replies[-1]):
            raise self._refused("no error", message, "; ".join([replies[-1], *self.errors()]))
        return replies[:-1]

    def _checked_numbers(self, message: str, count: int) -> tuple[float, ...]:
        return self._numbers(message, self._checked(message, count), count)

    def _numbers(self, sent: str, replies: Sequence[str], count: int) -> tuple[float, ...]:
        try:
            values = tuple(float(reply) for reply in replies)
        except ValueError as error:
            raise self._error(BadReply, f"{count} numbers", sent, ";".join(replies)) from error
        if len(values) != count or not all(map(math.isfinite, values)):
            raise self._error(BadReply, f"{count} numbers", sent, ";".join(replies))
        return values

    def _error_code(self, reply: str) -> int:
        """The number alone: what follows it is spelt differently by firmware."""
        try:
            return int(reply.split(",", 1)[0])
        except ValueError as error:
            raise self._error(BadReply, "an error number and its text", "SYST:ERR?", reply) from error

    def _raise_errors(self, sent: str) -> None:
        found = self.errors()
        if found:
            raise self._refused("no error", sent, "; ".join(found))

    def _trace(self, number: int, count: int | None) -> NDArray[np.float64]:
        """A trace of `count` big-endian doubles (FORMat REAL,64), or of as many as come."""
        sent = f"CALC{number}:DATA?"
        payload = self._link.query_block(sent)
        if not payload or len(payload) % 8 or (count is not None and len(payload) != 8 * count):
            wanted = f"a block of {8 * count} bytes" if count is not None else "a block of 64-bit reals"
            raise self._error(BadReply, wanted, sent, f"{len(payload)} bytes")
        return np.frombuffer(payload, ">f8").astype(np.float64)

    def _refused(
        self, wanted: str, sent: str | None = None, received: str | Sequence[float] | None = None
    ) -> Exception:
        text = (
            received if received is None or isinstance(received, str) else ";".join(f"{one:.10g}" for one in received)
        )
        return self._error(SettingRefused, wanted, sent, text)

    def _error(
        self, kind: type[InstrumentError], wanted: str, sent: str | None, received: str | None
    ) -> InstrumentError:
        return kind(self._link.instrument, self._link.address, sent=sent, received=received, wanted=wanted)


def _peak(dbm: float) -> float:
    """Peak volts across 50 Ω."""
    return math.sqrt(DBM_REFERENCE * 10.0 ** (dbm / 10.0))


def _named(bits: int) -> tuple[str, ...]:
    return tuple(name for mask, name in OVERLOADS if bits & mask)


def _read(kind: Callable[[str], str | float | int | bool], reply: str) -> str | float | int | bool:
    if kind is bool:
        return float(reply) != 0.0
    return int(float(reply)) if kind is int else kind(reply)


def connect(name: str, settings: Settings, room: Room) -> HP89410A:
    """Open the link; nothing is sent to the analyzer. Raises Disconnected."""
    link = VisaLink.open(
        name, settings.address, gateway=settings.gateway, timeout=settings.timeout, room=room, backend=settings.backend
    )
    return HP89410A(link, room)
