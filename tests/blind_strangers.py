"""Strangers: effects that a world can hide although no shelf lists them, and the ripple that no sensor effect explains.

They are written against the same points of the simulated physics as the fixtures' own shelf, but registered on none.
None of them is another name for an effect of the shelf: each differs from all of those in the data of its bench.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fixtures.channels import SHAKER_CABLES, Channel
from fixtures.imperfections import Imperfection
from fixtures.motion import Motion
from fixtures.scene import Scene
from fixtures.shelf.motion import integrated
from fixtures.strength import Sweep, Turns

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]
Ranges = Mapping[str, tuple[float, float]]
SHAKER, TURNTABLE = ("shaker",), ("turntable",)
TURN = (0.0, 2.0 * math.pi)
LATTICE = 0.1  # s, on which slow memories are worked out
WAVES = np.geomspace(0.4, 4.0, 6)  # of the ripple, rad per factor e of frequency


def excited(signal: Array) -> Array:
    """What of a signal over one period is not its mean."""
    return np.asarray(signal - signal.mean(axis=-1, keepdims=True))


@dataclass
class DriveSquared(Imperfection):
    """V += share·V_source²: the power of the drive, not its voltage, gets into every accelerometer; `share` 1/V."""

    name: ClassVar[str] = "drive_squared"
    stage: ClassVar[str] = "electronics"
    benches: ClassVar[tuple[str, ...]] = SHAKER
    size: ClassVar[str] = "share"
    limits: ClassVar[tuple[float, float]] = (1e-10, 0.1)
    typical: ClassVar[Ranges] = {"share": (1e-6, 1e-3)}
    share: float = 1e-5

    def added(self, channel: Channel, scene: Scene) -> Array | float:
        return self.share * scene.source**2 if channel.quantity == "acceleration" else 0.0


@dataclass
class Creep(Imperfection):
    """V0 += S·amount·Σ Δlevel·exp(−(t − t_change)/time_constant): the zero creeps after each change of level.

    `amount` m/s² per volt of the source's level; `time_constant` s.
    """

    name: ClassVar[str] = "creep"
    stage: ClassVar[str] = "transducer"
    benches: ClassVar[tuple[str, ...]] = SHAKER
    size: ClassVar[str] = "amount"
    limits: ClassVar[tuple[float, float]] = (1e-8, 10.0)
    typical: ClassVar[Ranges] = {"amount": (1e-3, 1e-1), "time_constant": (1.0, 5.0)}
    amount: float = 1e-2
    time_constant: float = 2.0

    def gain_and_zero(self, channel: Channel, scene: Scene) -> tuple[Array | float, Array | float]:
        if channel.quantity != "acceleration":
            return 1.0, 0.0
        total = np.zeros_like(scene.times)
        for drive in scene._source.drives:
            total += drive.level * (self._after(scene.times, drive.on) - self._after(scene.times, drive.off))
        return 1.0, channel.sensitivity * self.amount * total

    def _after(self, times: Array, change: float) -> Array:
        age = times - change
        return np.where(age >= 0.0, np.exp(-np.maximum(age, 0.0) / self.time_constant), 0.0)


@dataclass
class GainStep(Imperfection):
    """u → (1 + step)·u from the time `at` (s) on: something came loose, and nothing that is logged says so."""

    name: ClassVar[str] = "gain_step"
    stage: ClassVar[str] = "transducer"
    size: ClassVar[str] = "step"
    limits: ClassVar[tuple[float, float]] = (1e-8, 0.3)
    typical: ClassVar[Ranges] = {"step": (1e-4, 1e-2), "at": (80.0, 120.0)}
    step: float = 1e-3
    at: float = 100.0
    quantity: str = "acceleration"

    def gain_and_zero(self, channel: Channel, scene: Scene) -> tuple[Array | float, Array | float]:
        if channel.quantity != self.quantity:
            return 1.0, 0.0
        return np.where(scene.times >= self.at, 1.0 + self.step, 1.0), 0.0


@dataclass
class LogGain(Imperfection):
    """H = 1 + slope·ln(f/100 Hz), without phase: the gain follows the logarithm of the frequency, as no pole does."""

    name: ClassVar[str] = "log_gain"
    stage: ClassVar[str] = "dynamics"
    benches: ClassVar[tuple[str, ...]] = SHAKER
    size: ClassVar[str] = "slope"
    limits: ClassVar[tuple[float, float]] = (1e-8, 0.1)
    typical: ClassVar[Ranges] = {"slope": (1e-5, 1e-2)}
    slope: float = 1e-3

    def response(self, channel: Channel, frequency: Array) -> Spectrum | float:
        if channel.quantity != "acceleration":
            return 1.0
        return np.asarray(1.0 + self.slope * np.log(np.maximum(frequency, 1.0) / 100.0), np.complex128)


@dataclass
class LevelDelay(Imperfection):
    """y(t) = u(t − coefficient·peak(u)): a dead time that grows with the level; `coefficient` s per m/s²."""

    name: ClassVar[str] = "level_delay"
    stage: ClassVar[str] = "transducer"
    benches: ClassVar[tuple[str, ...]] = SHAKER
    size: ClassVar[str] = "coefficient"
    limits: ClassVar[tuple[float, float]] = (1e-11, 1e-4)
    typical: ClassVar[Ranges] = {"coefficient": (1e-7, 1e-5)}
    coefficient: float = 1e-6

    def transduce(self, channel: Channel, signal: Array, motion: Motion) -> Array:
        if channel.quantity != "acceleration" or not motion.periodic:
            return signal
        late = self.coefficient * float(np.max(np.abs(excited(signal))))
        return motion.filtered(signal, lambda f: np.asarray(np.exp(-2j * math.pi * f * late), np.complex128))


@dataclass
class VelocityProduct(Imperfection):
    """y = u + coefficient·u·∫u dt: the gain depends on the velocity of the seismic mass; `coefficient` s/m."""

    name: ClassVar[str] = "velocity_product"
    stage: ClassVar[str] = "transducer"
    benches: ClassVar[tuple[str, ...]] = SHAKER
    size: ClassVar[str] = "coefficient"
    limits: ClassVar[tuple[float, float]] = (1e-8, 10.0)
    typical: ClassVar[Ranges] = {"coefficient": (1e-4, 1e-1)}
    coefficient: float = 1e-2

    def transduce(self, channel: Channel, signal: Array, motion: Motion) -> Array:
        if channel.quantity != "acceleration" or not motion.periodic:
            return signal
        moving = excited(signal)
        return np.asarray(signal + self.coefficient * moving * motion.filtered(moving, integrated(1.0)))


@dataclass
class FieldBias(Imperfection):
    """ω_felt = ω + bias·cos³(θ − direction): every gyro reads a field that stands still while the platter turns.

    Once and three times per revolution together, at every rate and at rest; `bias` rad/s.
    """

    name: ClassVar[str] = "field_bias"
    stage: ClassVar[str] = "transducer"
    benches: ClassVar[tuple[str, ...]] = TURNTABLE
    size: ClassVar[str] = "bias"
    limits: ClassVar[tuple[float, float]] = (1e-8, 1.0)
    typical: ClassVar[Ranges] = {"bias": (1e-4, 1e-2), "direction": TURN}
    bias: float = 1e-3
    direction: float = 0.0

    def felt(self, channel: Channel, felt: Array, motion: Motion) -> Array:
        if channel.quantity != "rate" or motion.mount.place != "turntable":
            return felt
        return np.asarray(felt + self.bias * np.cos(motion.angle - self.direction) ** 3)


@dataclass
class RootBias(Imperfection):
    """ω_felt = ω + coefficient·√|ω|: even, like an asymmetry, but steepest at rest; `coefficient` √(rad/s)."""

    name: ClassVar[str] = "root_bias"
    stage: ClassVar[str] = "transducer"
    benches: ClassVar[tuple[str, ...]] = TURNTABLE
    size: ClassVar[str] = "coefficient"
    limits: ClassVar[tuple[float, float]] = (1e-8, 1.0)
    typical: ClassVar[Ranges] = {"coefficient": (1e-4, 1e-2)}
    coefficient: float = 1e-3

    def transduce(self, channel: Channel, signal: Array, motion: Motion) -> Array:
        if channel.quantity != "rate":
            return signal
        return np.asarray(signal + self.coefficient * np.sqrt(np.abs(signal)))


@dataclass
class MotionZero(Imperfection):
    """V0 += S·shift·(moving after a lag of time_constant): zeros go somewhere else once the platter moves, and back.

    `shift` rad/s; `time_constant` s. The same in both senses and at both speeds.
    """

    name: ClassVar[str] = "motion_zero"
    stage: ClassVar[str] = "transducer"
    benches: ClassVar[tuple[str, ...]] = TURNTABLE
    size: ClassVar[str] = "shift"
    limits: ClassVar[tuple[float, float]] = (1e-7, 1.0)
    typical: ClassVar[Ranges] = {"shift": (1e-4, 1e-2), "time_constant": (5.0, 20.0)}
    shift: float = 1e-3
    time_constant: float = 10.0

    def gain_and_zero(self, channel: Channel, scene: Scene) -> tuple[Array | float, Array | float]:
        if channel.quantity != "rate":
            return 1.0, 0.0
        return 1.0, channel.sensitivity * self.shift * self._settled(scene)

    def _settled(self, scene: Scene) -> Array:
        """Between 0 and 1 at every instant."""
        first, last = float(scene.times.min()), float(scene.times.max())
        memory = 8.0 * self.time_constant
        nodes = np.arange(max(first - memory, 0.0), last + 2.0 * LATTICE, LATTICE)
        moving = np.abs(scene._platter.motion(nodes)[1]) > 1e-3
        ages = np.arange(0.0, memory, LATTICE)
        weights = np.exp(-ages / self.time_constant)
        lagged = np.convolve(moving, weights / weights.sum())[: len(nodes)]
        return np.interp(scene.times, nodes, lagged)


@dataclass
class Ripple(Imperfection):
    """H = 1 + relative·z(ln f): smooth, complex, each sensor its own on the shaker, and another after every remount.

    `relative` is the rms of real and imaginary part together.
    """

    name: ClassVar[str] = "ripple"
    stage: ClassVar[str] = "motion"
    benches: ClassVar[tuple[str, ...]] = SHAKER
    relative: float = 1e-3

    def __post_init__(self) -> None:
        self._waves = np.zeros((len(SHAKER_CABLES), 4, len(WAVES)))

    def remount(self, random: np.random.Generator) -> None:
        self._waves = random.standard_normal(self._waves.shape) / math.sqrt(2.0 * len(WAVES))

    def response(self, channel: Channel, frequency: Array) -> Spectrum | float:
        if not channel.is_sensor or channel.name not in SHAKER_CABLES:
            return 1.0
        turned = np.log(np.maximum(frequency, 1.0) / 100.0)[..., None] * WAVES
        a, b, c, d = self._waves[SHAKER_CABLES.index(channel.name)]
        cosine, sine = np.cos(turned), np.sin(turned)
        ripple = cosine @ (a + 1j * b) + sine @ (c + 1j * d)
        return np.asarray(1.0 + self.relative * ripple * (frequency > 0.0), np.complex128)


KINDS: Mapping[str, tuple[type[Imperfection], ...]] = {
    "shaker": (DriveSquared, Creep, GainStep, LogGain, LevelDelay, VelocityProduct),
    "turntable": (FieldBias, RootBias, MotionZero, GainStep),
}


def kind_of(name: str) -> type[Imperfection]:
    """The class of that name; raises KeyError."""
    kinds: dict[str, type[Imperfection]] = {kind.name: kind for all_ in KINDS.values() for kind in all_}
    return kinds[name]


def sized(
    kind: type[Imperfection], parameters: Mapping[str, Any], wanted: float, measure: Sweep | Turns
) -> dict[str, Any]:
    """The parameters with the size at which d′ is within 3 % of what is wanted, by bisection of the logarithm."""
    low, high = (math.log(one) for one in kind.limits)
    x = math.log(float(parameters[kind.size]))
    for _ in range(16):
        found = measure.strength((kind(**{**parameters, kind.size: math.exp(x)}),))
        if abs(found / wanted - 1.0) < 0.03:
            break
        low, high = (x, high) if found < wanted else (low, x)
        proportional = x + math.log(wanted / max(found, 1e-9))
        x = proportional if low < proportional < high else 0.5 * (low + high)
    return {**parameters, kind.size: math.exp(x)}
