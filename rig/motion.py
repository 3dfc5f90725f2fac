"""What the unit went through, on a grid that an effect can work on: periods of sines, or stretches of time.

Both kinds of experiment look alike to an effect. A *grid* says at which instants signals are worked out and what a
linear system does to them:

- `Periods`: p steady sines, each one whole period; signals have shape (…, p, phases), and what is
  observed of them are their harmonics 0 … 5, complex, shape (…, p, 6);
- `Stretches`: n evenly spaced instants of several records one after the other; signals and observations have shape
  (…, n). A record's ends are continued along straight lines before it is filtered.

Vectors are in the case frame (first axis x, y, z); angles of the platter count about the upward axis from the encoder's
index, so they fall while it turns clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Response = Callable[[Array], Complexes]

PHASES = 64  # enough for a cube of five harmonics
FINE = 512  # phases for a characteristic with a kink, whose high harmonics would fold into low ones
ORDERS = 6  # harmonics 0 … 5
MARGIN = 64  # samples added to a record before it is filtered
NEARLY_STILL = 1e-3  # Hz, where the slope of a phase at rest is taken


@lru_cache(maxsize=4)
def _transforms(phases: int) -> tuple[Array, Complexes]:
    """From one period to its harmonics, real and imaginary parts in turn, and back: (phases, 12) and (6, phases)."""
    angles = 2.0 * math.pi * np.arange(phases) / phases
    analysis = np.exp(-1j * np.outer(angles, np.arange(ORDERS))) * (2.0 / phases)
    analysis[:, 0] /= 2.0
    return analysis.view(np.float64), np.exp(1j * np.outer(np.arange(ORDERS), angles))


class Grid(Protocol):
    """Where signals are worked out."""

    def taken(self, signal: Array) -> NDArray[np.inexact]:
        """What of a signal decides what is seen of it after any linear system."""
        ...

    def passed(self, taken: NDArray[np.inexact], response: Response) -> NDArray[np.inexact]:
        """What is seen of that after a linear system with this complex response (Hz in)."""
        ...

    def observed(self, signal: Array, response: Response) -> NDArray[np.inexact]:
        """What is seen of a signal after such a system."""
        return self.passed(self.taken(signal), response)

    def leaked(self, observed: NDArray[np.inexact], corner: float) -> NDArray[np.inexact]:
        """What is left of what is seen behind a first-order high-pass with this corner, Hz."""
        ...

    def plain(self, signal: Array) -> NDArray[np.inexact]:
        """What is seen of a signal itself."""
        ...

    def each(self, values: Array) -> Array:
        """Values of the records (p,) or instants (n,) in a shape that multiplies what is observed."""
        ...

    def rise(self, signal: Array) -> Array:
        """Derivative in time, unit of the signal per second, same shape."""
        ...


@dataclass(frozen=True)
class Periods(Grid):
    """Steady sines; `frequency` Hz, shape (p,), each worked out at so many `phases`."""

    frequency: Array
    phases: int = PHASES

    @property
    def harmonics(self) -> Array:
        """Frequencies of the harmonics 0 … 5, Hz, shape (p, 6)."""
        return np.multiply.outer(self.frequency, np.arange(ORDERS, dtype=np.float64))

    def taken(self, signal: Array) -> Complexes:
        return self.plain(signal)

    def passed(self, taken: NDArray[np.inexact], response: Response) -> Complexes:
        return np.asarray(taken * response(self.harmonics))

    def leaked(self, observed: NDArray[np.inexact], corner: float) -> Complexes:
        """A mean is the zero output's, which is free anyway, and stays as it is."""
        f = np.where(self.harmonics > 0.0, self.harmonics, math.inf)
        return np.asarray(observed / (1.0 - 1j * corner / f))

    def plain(self, signal: Array) -> Complexes:
        return np.ascontiguousarray(signal @ _transforms(self.phases)[0]).view(np.complex128)

    def each(self, values: Array) -> Array:
        return values[..., None]

    def waveform(self, harmonics: Complexes) -> Array:
        """One period from harmonics 0 … 5, shapes (…, p, 6) to (…, p, phases)."""
        return np.asarray((harmonics @ _transforms(self.phases)[1]).real)

    def rise(self, signal: Array) -> Array:
        order = 2j * math.pi * np.arange(self.phases // 2 + 1) * self.frequency[:, None]
        return np.asarray(np.fft.irfft(np.fft.rfft(signal) * order, self.phases))


@dataclass(frozen=True)
class Stretches(Grid):
    """Records one after the other: `interval` s between instants, `bounds` of each record among them.

    `lines`: of every record the line of time it belongs to and the place of its first instant on that, in intervals;
    left out, each has one of its own. What has a long memory begins where a line does, at rest with what is there.
    """

    interval: float
    bounds: tuple[tuple[int, int], ...]
    lines: tuple[tuple[int, int], ...] = ()

    def taken(self, signal: Array) -> Array:
        return signal

    def passed(self, taken: NDArray[np.inexact], response: Response) -> Array:
        signal = np.asarray(taken, np.float64)
        found, passed = np.empty_like(signal), response(self._frequencies)
        for (begin, end), (length, here) in zip(self.bounds, self._transforms, strict=True):
            found[..., begin:end] = self._filtered(signal[..., begin:end], passed[..., :2], passed[..., here], length)
        return found

    @cached_property
    def _transforms(self) -> list[tuple[int, slice]]:
        """Length of every record's transform, and where its lines stand among all frequencies."""
        from scipy.fft import next_fast_len

        lengths = [int(next_fast_len(end - begin + MARGIN, real=True)) for begin, end in self.bounds]
        places, at = {}, 2
        for length in dict.fromkeys(lengths):
            places[length] = slice(at, at + length // 2 + 1)
            at += length // 2 + 1
        return [(length, places[length]) for length in lengths]

    @cached_property
    def _frequencies(self) -> Array:
        """Zero, nearly zero, and the lines of every length of transform one after the other, Hz."""
        lengths = dict.fromkeys(length for length, _ in self._transforms)
        return np.concatenate([[0.0, NEARLY_STILL], *(np.fft.rfftfreq(one, self.interval) for one in lengths)])

    def leaked(self, observed: NDArray[np.inexact], corner: float) -> Array:
        """Along every line of time; between its records a signal goes straight on."""
        signal = np.asarray(observed, np.float64)
        found = signal.copy()
        for places, at in self._on_lines:
            whole = np.arange(at[-1] + 1)
            here = np.array([np.interp(whole, at, one) for one in signal[..., places].reshape(-1, len(at))])
            slow = _followed(here - here[:, :1], abs(corner) * 2.0 * math.pi * self.interval)[:, at] + here[:, :1]
            found[..., places] -= math.copysign(1.0, corner) * slow.reshape(found[..., places].shape)
        return found

    @cached_property
    def _on_lines(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Instants of every line of time, and their places on it."""
        found: dict[int, list[tuple[NDArray[np.intp], NDArray[np.intp]]]] = {}
        lines = self.lines or tuple((number, 0) for number in range(len(self.bounds)))
        for (begin, end), (line, first) in zip(self.bounds, lines, strict=True):
            found.setdefault(line, []).append((np.arange(begin, end), first + np.arange(end - begin)))
        joined = [tuple(map(np.concatenate, zip(*one, strict=True))) for one in found.values()]
        return [(places, at - at[0]) for places, at in joined]

    def plain(self, signal: Array) -> Array:
        """The mean over a window of what is given at its middle: fast signals lose by it."""
        return np.asarray(
            self.observed(signal, lambda f: np.asarray(np.sinc(f * self.interval), np.complex128)), np.float64
        )

    def each(self, values: Array) -> Array:
        return values

    def rise(self, signal: Array) -> Array:
        found = np.empty_like(signal)
        for begin, end in self.bounds:
            found[..., begin:end] = np.gradient(signal[..., begin:end], self.interval, axis=-1)
        return found

    def _filtered(self, signal: Array, slow: Complexes, passed: Complexes, length: int) -> Array:
        """A record after what passes of nothing and of nearly nothing, `slow`, and of the lines of its transform.

        A ramp a + bt leaves H(0)(a + bt) + b·H′(0); what is left after the line through both ends goes round.
        """
        from scipy.fft import irfft, rfft

        found = np.asarray(slow[..., :1].real * signal)
        busy = (signal != signal[..., :1]).any(axis=-1)  # what rests goes through as it is
        if busy.any():
            own, slow, passed = signal[busy], *(one[busy] if one.ndim > 1 else one for one in (slow, passed))
            slope = (own[..., -1:] - own[..., :1]) / max(own.shape[-1] - 1, 1)
            line = own[..., :1] + slope * np.arange(own.shape[-1])
            late = slope / self.interval * (slow[..., 1:].imag / (2.0 * math.pi * NEARLY_STILL))
            turned = irfft(rfft(own - line, length) * passed, length)[..., : own.shape[-1]]
            found[busy] = turned + (slow[..., :1].real * line + late)
        return found


@dataclass(frozen=True)
class Motion:
    """Motion of the case and what surrounded it; G is the grid's shape: (p, phases) or (n,), R that of records: (p,)
    or (n,).

    `force` specific force m/s², `rate` rad/s, `turning` angular acceleration rad/s², all (3, *G). `up` unit vector,
    (3, R). `gravity` m/s². Conditions, all R: `temperature` °C, `supply` V, `elapsed` s since the first record of its
    session.

    On the shaker: `along` complex acceleration of the drive's harmonics, m/s², (p, 6); `drive` and `side` unit vectors
    (3, p); `source` open-circuit drive, V peak, and `scale` of the vibrometer, (m/s)/V, both (p,). On the turntable:
    `angle` of the platter rad, `motor` whether it is driven, both (n,); `outward` and `tangent` (upward axis × outward)
    unit vectors, (3, n).
    """

    grid: Grid
    place: str
    force: Array
    rate: Array
    turning: Array
    up: Array
    gravity: float
    temperature: Array
    supply: Array
    elapsed: Array
    along: Complexes = field(default_factory=lambda: np.zeros((0, ORDERS), np.complex128))
    drive: Array = field(default_factory=lambda: np.zeros((3, 0)))
    side: Array = field(default_factory=lambda: np.zeros((3, 0)))
    source: Array = field(default_factory=lambda: np.zeros(0))
    scale: Array = field(default_factory=lambda: np.zeros(0))
    angle: Array = field(default_factory=lambda: np.zeros(0))
    motor: Array = field(default_factory=lambda: np.zeros(0))
    outward: Array = field(default_factory=lambda: np.zeros((3, 0)))
    tangent: Array = field(default_factory=lambda: np.zeros((3, 0)))

    def with_force(self, more: Array) -> Motion:
        """The same with this specific force added, (3, *G)."""
        return replace(self, force=self.force + more)

    @property
    def sines(self) -> Periods:
        """The grid of a motion that is driven by sines; TypeError for another."""
        if not isinstance(self.grid, Periods):
            raise TypeError("found a motion that is not driven by sines")
        return self.grid

    @property
    def harmonics(self) -> Array:
        """Frequencies of the drive's harmonics, Hz, (p, 6)."""
        return self.sines.harmonics

    def driven_by(self, response: Complexes) -> Array:
        """The drive's acceleration after a response at its harmonics (p, 6), as a waveform, m/s², (p, phases)."""
        return self.sines.waveform(self.along * response)

    def drive_waveform(self) -> Array:
        """Open-circuit voltage of the source, V, (p, phases): it pushes against the acceleration (a = −ω²kV)."""
        first = np.zeros_like(self.along)
        size = np.abs(self.along[:, 1])
        first[:, 1] = -self.source * self.along[:, 1] / np.where(size > 0.0, size, 1.0)
        return self.sines.waveform(first)


def _followed(signal: Array, step: float) -> Array:
    """What follows signals (k, n) from nought with a time constant of 1/step intervals, exact for straight pieces: a
    convolution with e^(−step·n), by a transform.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    count, kept = signal.shape[-1], math.exp(-step)
    mean = -math.expm1(-step) / step if step > 0.0 else 1.0
    later = (kept * (1.0 - mean) + mean - kept) * kept ** np.arange(count - 1)
    kernel = np.concatenate([[1.0 - mean], later])
    length = int(next_fast_len(2 * count, real=True))
    return np.asarray(irfft(rfft(signal, length) * rfft(kernel, length), length)[..., :count])


def rigid(motion: Motion, arm: Array) -> Array:
    """What a point at `arm` (m, case frame, (3,)) feels more than the origin: α×r + ω×(ω×r), m/s², (3, *G)."""
    arms = np.broadcast_to(arm.reshape(3, *(1,) * (motion.rate.ndim - 1)), motion.rate.shape)
    inward = np.cross(motion.rate, np.cross(motion.rate, arms, axis=0), axis=0)
    return np.asarray(np.cross(motion.turning, arms, axis=0) + inward)
