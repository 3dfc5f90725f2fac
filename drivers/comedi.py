"""PC104-DAS16JR/16 in this machine: the board through comedilib (Linux), reached with ctypes.

Two layers: `Board` sets up and streams one command of comedi's analog-input subdevice, and is what the DAQ service
(`daq_service`) serves to the network; `Comedi` makes a recorder of it, with the same checks and the same answers as the
remote one (`das16jr`). Codes stay raw: comedilib's own conversion gives NaN for the first and the last code.

Facts: comedilib 0.11 (`lib/timed.c`, `comedi.h`) and the kernel's `das16.c` and `comedi_fops.c`. The kernel's driver
believes what comedi_config was told of the 1/10 MHz pacer jumper, so the rate is held against this machine's clock.
"""

from __future__ import annotations

import ctypes
import errno
import math
import os
import select
import time
from collections.abc import Callable, Mapping, Sequence
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_uint, c_void_p
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivers import scans as scanning
from drivers.scans import Pacer, Record, Tag
from rig.errors import AcquisitionFailed, InstrumentError, NoAnswer, SettingRefused, WrongIdentity
from rig.record import Channel, Identity, Samples, Timing
from rig.room import Room
from rig.units import Ratio, Time, Voltage

BOARD = "pc104-das16jr/16"
"""What comedi calls the board."""

TRIG_NONE, TRIG_NOW, TRIG_FOLLOW, TRIG_TIMER, TRIG_COUNT = 1, 2, 4, 0x10, 0x20
AREF_GROUND = 0
SDF_CMD_READ, SDF_LSAMPL = 0x8000, 0x10000000
MAXDATA = 65535
CHUNK = 4 << 20
"""Bytes read at once: more than comedi's default buffer, so that one read takes all there is."""

PASSES = 5
"""How often comedi_command_test may adjust a command before it counts as refused."""

OBJECTIONS = (
    "",
    "a trigger source is not supported",
    "trigger sources contradict one another",
    "an argument is out of range",
    "an argument had to be rounded",
    "the channels are not consecutive and ascending with one range",
)
"""What the result of comedi_command_test means."""


class CommandStructure(ctypes.Structure):
    """`comedi_cmd`: 80 bytes on x86-64."""

    _fields_ = [
        ("subdev", c_uint),
        ("flags", c_uint),
        ("start_src", c_uint),
        ("start_arg", c_uint),
        ("scan_begin_src", c_uint),
        ("scan_begin_arg", c_uint),
        ("convert_src", c_uint),
        ("convert_arg", c_uint),
        ("scan_end_src", c_uint),
        ("scan_end_arg", c_uint),
        ("stop_src", c_uint),
        ("stop_arg", c_uint),
        ("chanlist", POINTER(c_uint)),
        ("chanlist_len", c_uint),
        ("data", POINTER(ctypes.c_short)),
        ("data_len", c_uint),
    ]


class RangeStructure(ctypes.Structure):
    """`comedi_range`: 24 bytes."""

    _fields_ = [("min", c_double), ("max", c_double), ("unit", c_uint)]


def cr_pack(channel: int, gain: int, reference: int = AREF_GROUND) -> int:
    """comedi's CR_PACK: channel, range index and analog reference in one number."""
    return (reference & 0x3) << 24 | (gain & 0xFF) << 16 | channel & 0xFFFF


FUNCTIONS: Mapping[str, tuple[Any, ...]] = MappingProxyType(
    {
        "comedi_open": (c_void_p, c_char_p),
        "comedi_close": (c_int, c_void_p),
        "comedi_errno": (c_int,),
        "comedi_strerror": (c_char_p, c_int),
        "comedi_fileno": (c_int, c_void_p),
        "comedi_get_board_name": (c_char_p, c_void_p),
        "comedi_get_driver_name": (c_char_p, c_void_p),
        "comedi_get_subdevice_flags": (c_int, c_void_p, c_uint),
        "comedi_get_n_channels": (c_int, c_void_p, c_uint),
        "comedi_get_maxdata": (c_uint, c_void_p, c_uint, c_uint),
        "comedi_get_n_ranges": (c_int, c_void_p, c_uint, c_uint),
        "comedi_get_range": (POINTER(RangeStructure), c_void_p, c_uint, c_uint, c_uint),
        "comedi_get_buffer_size": (c_int, c_void_p, c_uint),
        "comedi_get_cmd_generic_timed": (c_int, c_void_p, c_uint, POINTER(CommandStructure), c_uint, c_uint),
        "comedi_command_test": (c_int, c_void_p, POINTER(CommandStructure)),
        "comedi_set_read_subdevice": (c_int, c_void_p, c_uint),
        "comedi_command": (c_int, c_void_p, POINTER(CommandStructure)),
        "comedi_cancel": (c_int, c_void_p, c_uint),
    }
)
"""Every function used: its result and its arguments (comedilib.h)."""

MESSAGES: tuple[str, ...] = tuple(FUNCTIONS)
"""What this driver can 'send': calls into comedilib."""


class Library:
    """comedilib: its functions with their prototypes, as attributes."""

    def __init__(self, functions: Any) -> None:
        """`functions` has every name of FUNCTIONS as a C function: a loaded library, or one made of callbacks."""
        self._keep = functions
        for name, (result, *arguments) in FUNCTIONS.items():
            address = ctypes.cast(getattr(functions, name), c_void_p).value
            if not address:
                raise OSError(f"{name} has no address")
            setattr(self, name, ctypes.CFUNCTYPE(result, *arguments)(address))

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


def load(path: str) -> Library:
    """comedilib from the system's search path or a file. Raises OSError if it, or one of its functions, is missing."""
    try:
        return Library(ctypes.CDLL(path))
    except AttributeError as error:
        raise OSError(f"{path} is not comedilib: {error}") from error


class Settings(BaseModel):
    """The board's device node and what the tag channel must read."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    device: str = Field(default="/dev/comedi0", description="comedi device node")
    library: str = Field(default="libcomedi.so.0", description="comedilib, by name or path")
    subdevice: int = Field(default=0, ge=0, description="analog input")
    serial: str = Field(default="not stated", description="from the plate: the board cannot be asked")
    clock: int = Field(
        default=1_000_000, description="pacer clock that comedi_config was told, Hz; kept with the record"
    )
    tag: str = Field(default="tag", description="name of the channel that carries the tag voltage")
    tag_voltage: Voltage = Field(default=2.5, description="what the tag channel must read")
    tag_tolerance: Voltage = Field(default=0.05, gt=0)
    tag_step: Voltage = Field(default=0.01, gt=0, description="largest change of the tag from one scan to the next")
    clock_tolerance: Ratio = Field(default=0.02, gt=0, lt=1, description="pacer against this machine's clock")
    timeout: Time = Field(default=2.0, gt=0, description="real time of silence before data are missing")


class Board:
    """One open board: set up a command, start it, read lumps of codes, stop it."""

    def __init__(
        self,
        name: str,
        settings: Settings,
        library: Library,
        reader: Callable[[int, int], bytes] = os.read,
    ) -> None:
        """Opens the device; changes nothing on the board. `reader(fd, bytes)` reads as the kernel's read() does.

        Raises NoAnswer if it cannot be opened, WrongIdentity if it is not a board that can stream 16-bit samples.
        """
        self.instrument, self.address = name, settings.device
        self.serial, self.clock = settings.serial, settings.clock
        self._library, self._reader, self._subdevice = library, reader, settings.subdevice
        self._command, self._channels = CommandStructure(), (c_uint * 0)()
        self._device: int | None = library.comedi_open(settings.device.encode())
        if not self._device:
            raise NoAnswer(name, settings.device, sent="comedi_open", received=self._why(), wanted="a comedi device")
        self.name = bytes(library.comedi_get_board_name(self._device)).decode("latin-1")
        self.driver = bytes(library.comedi_get_driver_name(self._device)).decode("latin-1")

    def require_streaming(self) -> None:
        """Raises WrongIdentity if the subdevice has no streaming command or no 16-bit samples.

        Without a DMA channel in comedi_config the das16 driver offers no command at all.
        """
        flags = self._library.comedi_get_subdevice_flags(self._device, self._subdevice) & 0xFFFFFFFF
        depth = self._library.comedi_get_maxdata(self._device, self._subdevice, 0)
        if not flags & SDF_CMD_READ or flags & SDF_LSAMPL or depth != MAXDATA:
            found = f"flags {flags:#x}, maxdata {depth}"
            wanted = "a subdevice that streams 16-bit samples (a DMA channel given to comedi_config)"
            raise self.error(WrongIdentity, "comedi_get_subdevice_flags", found, wanted)

    def range(self, gain: int) -> tuple[float, float]:
        """Ends of a range, V. Raises SettingRefused if the board has no such range."""
        count = self._library.comedi_get_n_ranges(self._device, self._subdevice, 0)
        if not 0 <= gain < count:
            raise self.error(SettingRefused, None, None, f"gain code 0…{count - 1}, found {gain}")
        found = self._library.comedi_get_range(self._device, self._subdevice, 0, gain)
        if not found:
            raise self.error(SettingRefused, f"comedi_get_range {gain}", self._why(), "a range")
        return float(found.contents.min), float(found.contents.max)

    def set_up(self, first: int, last: int, gain: int, scan_ns: int) -> int:
        """Prepare a command on channels first…last, `scan_ns` per scan; returns the conversion period, ns, read back.

        Raises SettingRefused.
        """
        count = last - first + 1
        command = CommandStructure()
        self._demand(
            "comedi_get_cmd_generic_timed",
            self._library.comedi_get_cmd_generic_timed(self._device, self._subdevice, byref(command), count, scan_ns),
        )
        channels = (c_uint * count)(*(cr_pack(slot, gain) for slot in range(first, last + 1)))
        command.chanlist, command.chanlist_len = channels, count
        command.scan_end_arg = count
        command.stop_src, command.stop_arg = TRIG_NONE, 0
        self._settle(command)
        if (command.scan_begin_src, command.convert_src) != (TRIG_FOLLOW, TRIG_TIMER):
            found = f"scan_begin_src {command.scan_begin_src}, convert_src {command.convert_src}"
            raise self.error(SettingRefused, "comedi_command_test", found, "evenly timed conversions")
        self._command, self._channels = command, channels
        return int(command.convert_arg)

    def start(self, scans: int) -> None:
        """Run the prepared command for so many scans (0: until cancelled). Raises SettingRefused."""
        period = self._command.convert_arg
        self._command.stop_src, self._command.stop_arg = (TRIG_COUNT, scans) if scans else (TRIG_NONE, 0)
        self._settle(self._command)
        if self._command.convert_arg != period:
            raise self.error(
                SettingRefused, "comedi_command_test", str(self._command.convert_arg), f"{period} ns as set"
            )
        self._demand(
            "comedi_set_read_subdevice", self._library.comedi_set_read_subdevice(self._device, self._subdevice)
        )
        self._demand("comedi_command", self._library.comedi_command(self._device, byref(self._command)))

    def fileno(self) -> int:
        """The descriptor that becomes readable when there are data or the command has ended."""
        return int(self._library.comedi_fileno(self._device))

    def read(self) -> bytes:
        """What has been converted; empty when the command has ended. Raises OSError: EPIPE after a buffer overflow."""
        return self._reader(self.fileno(), CHUNK)

    def cancel(self) -> None:
        """Stop converting. Raises AcquisitionFailed if comedi says it did not."""
        if self._library.comedi_cancel(self._device, self._subdevice) < 0:
            raise self.error(AcquisitionFailed, "comedi_cancel", self._why(), "the command to stop")

    def close(self) -> None:
        """Close the device, which also cancels."""
        if self._device:
            self._library.comedi_close(self._device)
            self._device = None

    def describe(self) -> dict[str, str | float | int | bool]:
        """The prepared command and the kernel's buffer, bytes."""
        return {
            "board": self.name,
            "driver": self.driver,
            "convert_period": self._command.convert_arg * 1e-9,
            "channels": int(self._command.chanlist_len),
            "gain": (self._channels[0] >> 16) & 0xFF if len(self._channels) else 0,
            "buffer": int(self._library.comedi_get_buffer_size(self._device, self._subdevice)),
            "pacer_clock": self.clock,
        }

    def error(
        self, kind: type[InstrumentError], sent: str | None, received: str | None, wanted: str
    ) -> InstrumentError:
        return kind(self.instrument, self.address, sent=sent, received=received, wanted=wanted)

    def _settle(self, command: CommandStructure) -> None:
        """Let the driver adjust the command until it has no objection. Raises SettingRefused with the last one."""
        objection = 0
        for _ in range(PASSES):
            objection = self._library.comedi_command_test(self._device, byref(command))
            if objection == 0:
                return
            if objection not in (1, 2, 3, 4):
                break
        known = 0 < objection < len(OBJECTIONS)
        found = OBJECTIONS[objection] if known else f"result {objection}, {self._why()}"
        raise self.error(SettingRefused, "comedi_command_test", found, "a command without objections")

    def _demand(self, call: str, result: int) -> None:
        if result < 0:
            raise self.error(SettingRefused, call, self._why(), "success")

    def _why(self) -> str:
        """comedilib's last error in words."""
        number = self._library.comedi_errno()
        text = self._library.comedi_strerror(number)
        return f"error {number}, {bytes(text).decode('latin-1') if text else 'no text'}"


def open_board(
    name: str, settings: Settings, library: Library | None = None, reader: Callable[[int, int], bytes] = os.read
) -> Board:
    """Load comedilib (unless it is given) and open the board. Raises NoAnswer."""
    if library is None:
        try:
            library = load(settings.library)
        except OSError as error:
            wanted = f"comedilib (Debian package libcomedi0): {error}"
            raise NoAnswer(name, settings.device, sent=f"load {settings.library}", wanted=wanted) from error
    return Board(name, settings, library, reader)


class Comedi:
    """The converter as a recorder, in this machine."""

    def __init__(
        self, board: Board, settings: Settings, room: Room, monotonic_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """`monotonic_ns` is the clock that the pacer is held against."""
        self._board, self._settings, self._room, self._monotonic_ns = board, settings, room, monotonic_ns
        self._channels: tuple[Channel, ...] = ()
        self._timing: Timing | None = None
        self._record: Record | None = None
        self._running = False
        self._odd = b""

    def identify(self) -> Identity:
        """Board and driver as comedi names them. Raises WrongIdentity."""
        if self._board.name != BOARD:
            raise self._board.error(WrongIdentity, "comedi_get_board_name", self._board.name, BOARD)
        self._board.require_streaming()
        return Identity("Measurement Computing", self._board.name.upper(), self._board.serial, self._board.driver)

    def configure(self, *, rate: float, channels: Sequence[str], gain: int = 0) -> Timing:
        """Channels 0…n−1 by name, scans per second (Hz), gain code; returns what the board really does.

        The board then converts for a moment (0.15 s), so that a wrong pacer clock shows before a record depends on it:
        later, data are only taken when they are wanted. Raises AcquisitionFailed if it does; SettingRefused: before
        anything is asked of comedi if the tag is missing or the rate is out of range.
        """
        wrong = scanning.refusal(rate, channels, self._settings.tag)
        if wrong:
            raise self._board.error(SettingRefused, None, None, wrong)
        self.stop()
        low, high = self._board.range(gain)
        convert_ns = self._board.set_up(0, len(channels) - 1, gain, round(1e9 / rate))
        self._channels = tuple(Channel(name, slot, low, high) for slot, name in enumerate(channels))
        self._timing = Timing(convert_ns * 1e-9, len(channels))
        self._check_pacer(self._timing)
        return self._timing

    def start(self, scans: int | None) -> None:
        """Begin a record of so many scans, or until `stop`. Raises SettingRefused."""
        if self._timing is None or (scans is not None and scans < 1):
            wanted = "configure first" if self._timing is None else f"at least one scan, found {scans}"
            raise self._board.error(SettingRefused, None, None, wanted)
        self.stop()
        one = self._settings
        column = [channel.name for channel in self._channels].index(one.tag)
        tag = Tag(column, one.tag_voltage, one.tag_tolerance, one.tag_step)
        # One scan more than will be handed out: its tag proves that the last one did not slip.
        self._board.start(0 if scans is None else scans + 1)
        start, begun = self._room.clock.now(), self._monotonic_ns()
        self._running, self._odd = True, b""
        self._record = Record(
            self._channels, self._timing, tag, scans=scans, start=start, pacer_tolerance=one.clock_tolerance
        )
        self._record.begin(begun)

    def read(self, scans: int) -> Samples:
        """The next `scans` scans; fewer, with the flag "last", when the record ends there.

        Lets the bench's time pass as long as the data need, then waits in real time. Raises AcquisitionFailed when the
        record ended early (`state` says how; `received` gives the good scans that are left), NoAnswer.
        """
        record = self._started()
        if not scanning.await_scans(record, scans, self._room.clock, self._pump, self._settings.timeout):
            silence = f"no data for {self._settings.timeout:g} s"
            record.fail("silent", silence, f"samples after conversion {record.received}")
        if record.failure is not None and not record.has(scans):
            kind = NoAnswer if record.failure.state == "silent" else AcquisitionFailed
            good = f"{record.handed + record.available} good scans, {record.available} not read yet"
            raise self._board.error(kind, "comedi_command", record.failure.found, f"{record.failure.wanted} ({good})")
        return record.take(scans)

    def received(self) -> Samples:
        """The good scans that have arrived and were not read yet, without waiting; also after a failure or `stop`."""
        return self._started().take(self._started().available)

    @property
    def state(self) -> str:
        """`idle`, `running`, `done`, or how the record ended: `stopped`, `slip`, `clock`, `overflow`, `failed`."""
        return "idle" if self._record is None else self._record.state

    def stop(self) -> None:
        """End the record, if one is running. What had arrived is still there for `received`."""
        if self._running:
            while self._pump(0.0):
                pass
            self._board.cancel()
            self._running = False
        if self._record is not None:
            self._record.stop()

    def settings(self) -> dict[str, str | float | int | bool]:
        """The prepared command as the driver adjusted it (period s, gain code, channels); what the tag must be."""
        return {**self._board.describe(), "tag_voltage": self._settings.tag_voltage}

    def close(self) -> None:
        """Close the device; a running command is cancelled by that."""
        self._board.close()

    def _check_pacer(self, timing: Timing) -> None:
        pacer = Pacer(timing.convert_period, self._settings.clock_tolerance)
        self._board.start(0)
        pacer.begin(0, self._monotonic_ns())
        self._room.clock.sleep(3 * scanning.LUMP)
        converted = self._drained() // 2
        wrong = pacer.compare(converted, self._monotonic_ns())
        self._board.cancel()
        if wrong is not None:
            raise self._board.error(AcquisitionFailed, "comedi_command", wrong.found, wrong.wanted)

    def _drained(self) -> int:
        """Bytes that the board has converted until now; they are thrown away."""
        count = 0
        while select.select([self._board.fileno()], [], [], 0.0)[0]:
            try:
                data = self._board.read()
            except OSError as error:
                raise self._board.error(AcquisitionFailed, "read", str(error), "conversions") from error
            count += len(data)
            if not data:
                break
        return count

    def _started(self) -> Record:
        if self._record is None:
            raise self._board.error(SettingRefused, None, None, "a started record")
        return self._record

    def _pump(self, timeout: float) -> bool:
        """Take in what is there within `timeout` s of real time; whether anything was."""
        if not self._running or not select.select([self._board.fileno()], [], [], timeout)[0]:
            return False
        record = self._started()
        try:
            data = self._odd + (lump := self._board.read())
        except BlockingIOError:
            return False
        except OSError as error:
            self._ended_early(record, error)
            return True
        whole = len(data) // 2 * 2
        self._odd = data[whole:]
        record.add(np.frombuffer(data[:whole], np.uint16), self._monotonic_ns(), prompt=False)
        if not lump:
            self._running = False
            self._end(record)
        return True

    def _end(self, record: Record) -> None:
        record.ended = True
        if record.short:
            scans = math.inf if record.scans is None else record.scans
            record.fail("short", f"the end after {record.received} conversions", f"{scans:g} scans and one for proof")

    def _ended_early(self, record: Record, error: OSError) -> None:
        self._board.cancel()
        self._running, record.ended = False, True
        if error.errno == errno.EPIPE:
            record.fail("overflow", "EPIPE, an overflow of comedi's buffer", "data read as they come")
        else:
            record.fail("failed", str(error), "a board that converts")


def connect(name: str, settings: Settings, room: Room) -> Comedi:
    """Load comedilib and open the device; nothing is set. Raises NoAnswer."""
    return Comedi(open_board(name, settings), settings, room)
