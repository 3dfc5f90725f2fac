"""Immutable records: what was measured, and nothing that was concluded. Raw counts, SI elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Identity:
    """What an instrument says it is."""

    maker: str
    model: str
    serial: str
    firmware: str

    def __str__(self) -> str:
        return f"{self.maker} {self.model} (serial {self.serial}, firmware {self.firmware})"


@dataclass(frozen=True)
class Channel:
    """One converter channel: its name in the wiring, its slot in the scan, and its range in volts."""

    name: str
    slot: int
    low: float
    high: float


@dataclass(frozen=True)
class Wires:
    """What the cables call the bench's own signals: the vibrometer, the supply and the thermometer of the unit.

    A bench file may call them otherwise under `signals`.
    """

    reference: str = "ldv"
    supply: str = "supply"
    temperature: str = "temperature"


@dataclass(frozen=True)
class Timing:
    """When a scanning converter samples: channel k of scan n is converted at (n·channels + k)·convert_period.

    `convert_period` (s) is the value read back from the board, never the one asked for.
    """

    convert_period: float
    channels: int

    @property
    def scan_period(self) -> float:
        """Time between two conversions of one channel, s."""
        return self.convert_period * self.channels

    @property
    def scan_rate(self) -> float:
        """Conversions of one channel per second, Hz."""
        return 1.0 / self.scan_period

    def instants(self, slot: int, scans: int, first_scan: int = 0) -> NDArray[np.float64]:
        """True sample instants of one channel since the first conversion of the record, s, shape (scans,)."""
        conversions = np.arange(first_scan, first_scan + scans) * self.channels + slot
        return np.asarray(conversions * self.convert_period, np.float64)


@dataclass(frozen=True)
class Samples:
    """A stretch of raw counts from a scanning 16-bit converter.

    `counts` is uint16 offset binary, shape (scans, channels): 0 is `low`, 65535 is `high` of the channel.
    `start` is the bench-clock time (s) of the record's first conversion (scan 0 of the record, not of this stretch);
    `first_scan` says where in the record this stretch begins. `flags` name what the service saw ("overflow",
    "clipped", "slip", "last", "clock"). `pace`, where it is known: how long the record was when it was looked at,
    s by the converter's clock and s by that of the machine which takes the conversions.
    """

    counts: NDArray[np.uint16]
    channels: tuple[Channel, ...]
    timing: Timing
    start: float
    first_scan: int = 0
    flags: frozenset[str] = frozenset()
    pace: tuple[float, float] | None = None

    def index(self, name: str) -> int:
        """Column of the named channel; ValueError if it is not in the record."""
        return [channel.name for channel in self.channels].index(name)

    def volts(self, name: str) -> NDArray[np.float64]:
        """One channel in volts, shape (scans,)."""
        column = self.index(name)
        channel = self.channels[column]
        return self.counts[:, column] / 65535.0 * (channel.high - channel.low) + channel.low

    def instants(self, name: str) -> NDArray[np.float64]:
        """True sample instants of one channel since the record's first conversion, s, shape (scans,)."""
        return self.timing.instants(self.channels[self.index(name)].slot, len(self.counts), self.first_scan)

    def clipped(self, name: str) -> int:
        """How many samples of the channel sit on the first or last code."""
        column = self.counts[:, self.index(name)]
        return int(np.count_nonzero((column == 0) | (column == 65535)))


@dataclass(frozen=True)
class Response:
    """A frequency response measured by a two-channel analyzer.

    `frequency` in Hz and complex `ratio` (channel 2 ÷ channel 1, V/V), both shape (n,); `coherence` shape (n,) or None.
    `averages` done; `overloads` names inputs that were over range while it was measured.
    """

    frequency: NDArray[np.float64]
    ratio: NDArray[np.complex128]
    coherence: NDArray[np.float64] | None
    averages: int
    overloads: tuple[str, ...] = ()

    def at(self, frequency: float) -> complex:
        """The ratio in the bin nearest to `frequency`."""
        return complex(self.ratio[int(np.argmin(np.abs(self.frequency - frequency)))])


@dataclass(frozen=True)
class Traces:
    """Simultaneous traces: volts, shape (channels, n), at `start + interval·i` seconds from the trigger.

    `clipped` counts the samples per channel that sat on the first or last code.
    """

    names: tuple[str, ...]
    volts: NDArray[np.float64]
    start: float
    interval: float
    clipped: tuple[int, ...] = ()

    def instants(self) -> NDArray[np.float64]:
        """Sampling instants from the trigger, s, shape (n,)."""
        return np.asarray(self.start + self.interval * np.arange(self.volts.shape[1]), np.float64)


@dataclass(frozen=True)
class ClockFit:
    """A device's clock against the bench's: bench time = offset + device time / (1 + rate_error).

    `offset` is the bench-clock time (s) of device time zero, including the mean latency of the link; `rate_error` is
    positive if the device's clock runs fast (1e-6 is 1 ppm). `u_offset` (s) and `u_rate` are standard uncertainties
    from the scatter of `used` arrivals; `late` arrivals were left out.
    """

    offset: float
    rate_error: float
    u_offset: float
    u_rate: float
    used: int
    late: int

    def bench_time(self, device: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bench-clock time (s) of device times (s since the record's first sample), same shape."""
        return self.offset + device / (1.0 + self.rate_error)


@dataclass(frozen=True)
class CubeSamples:
    """A stretch of raw counts from the Sensor Cube's own simultaneous converter; lost samples are absent, never filled.

    `counts` uint16, shape (n, 15), straight binary: 0 is 0 V, 65535 is 5 V. `sequence` and `device_us` (microseconds
    by the device's clock at the sampling instant) are int64, unwrapped, and count from the record's first sample;
    `flags` uint16 (1 over-range, 2 self-test, 4 converter fault, 8 supply low), `supply` and `temperature` raw uint16
    counts, all shape (n,). `gaps` samples are missing within this stretch, `bad_frames` did not survive the line.
    `start` is the bench-clock time (s) at which the record's first sample arrived, `rate` what the device set, Hz.
    """

    names: tuple[str, ...]
    counts: NDArray[np.uint16]
    sequence: NDArray[np.int64]
    device_us: NDArray[np.int64]
    flags: NDArray[np.uint16]
    supply: NDArray[np.uint16]
    temperature: NDArray[np.uint16]
    gaps: int
    bad_frames: int
    rate: float
    start: float
    clock: ClockFit | None = None

    def index(self, name: str) -> int:
        """Column of the named channel; ValueError if there is no such channel."""
        return self.names.index(name)

    def volts(self, name: str) -> NDArray[np.float64]:
        """One channel in volts, shape (n,)."""
        return np.asarray(self.counts[:, self.index(name)] / 65535.0 * 5.0, np.float64)

    def supply_volts(self) -> NDArray[np.float64]:
        """Supply, V, shape (n,): counted through a divider by two."""
        return np.asarray(self.supply / 65535.0 * 10.0, np.float64)

    def celsius(self) -> NDArray[np.float64]:
        """Temperature, °C, shape (n,)."""
        return np.asarray(self.temperature * 0.01 - 100.0, np.float64)

    def instants(self) -> NDArray[np.float64]:
        """Sampling instants of all channels by the device's clock since the record's first sample, s, shape (n,)."""
        return np.asarray(self.device_us * 1e-6, np.float64)

    def clipped(self, name: str) -> int:
        """How many samples of the channel sit on the first or last code."""
        column = self.counts[:, self.index(name)]
        return int(np.count_nonzero((column == 0) | (column == 65535)))
