"""What may be hidden in somebody else's device or reference: effects of the shelf, and strangers that no shelf lists.

Written out from the facts in the time domain, as what a case goes through turns into what its sensors show; shares no
line with the program's own effects. Signals are functions of time, (n,) → (3, n): rates in rad/s, forces in m/s².
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from imported_worlds import Unit, bessel_three
from numpy.typing import NDArray

Array = NDArray[np.float64]
Signal = Callable[[Array], Array]
Both = tuple[Signal, Signal]
Range = tuple[float, float]
H = 1e-3  # s, of a difference quotient


@dataclass(frozen=True)
class Law:
    """One thing that may be hidden: in which kinds of records, the range of its size in SI (drawn anew to the strength
    that is wanted), ranges of its other parameters, and how it acts.

    `acts` gives rates and forces as they are felt from those that are there; `shown` angles as an encoder shows them;
    `response` the complex gain at frequencies in Hz, of what is stated so and not as a law in time.
    """

    name: str
    kinds: tuple[str, ...]
    size: Range
    acts: Callable[[Both, Mapping[str, float], str], Both] | None = None
    more: Mapping[str, Range] = field(default_factory=dict)
    on: tuple[str, ...] = ("rate", "acceleration")
    shown: Callable[[Array, Mapping[str, float]], Array] | None = None
    response: Callable[[Array, Mapping[str, float]], Array] | None = None
    stranger: bool = False

    def drawn(self, random: np.random.Generator, quantities: Sequence[str]) -> dict[str, Any]:
        """Parameters for a device with channels of these quantities; the size is in the middle of its range."""
        found: dict[str, Any] = {name: float(random.uniform(*ends)) for name, ends in self.more.items()}
        possible = [on for on in self.on if on in quantities]
        return {"size": math.sqrt(self.size[0] * self.size[1]), **found, "on": str(random.choice(possible))}


@dataclass(frozen=True)
class Hiding(Unit):
    """A device with something hidden in it."""

    law: Law | None = None
    at: Mapping[str, Any] = field(default_factory=dict)

    def shown(self, t: Array, rate: Signal, force: Signal, seed: int) -> Array:
        if self.law is not None and self.law.acts is not None:
            rate, force = self.law.acts((rate, force), self.at, str(self.at["on"]))
        return super().shown(t, rate, force, seed)


def hiding(unit: Unit, law: Law, at: Mapping[str, Any]) -> Hiding:
    """The same unit with a law."""
    return Hiding(**vars(unit), law=law, at=at)


# of single values, of the past, and of time


def _static(law: Callable[[Array, float], Array]) -> Callable[[Both, Mapping[str, float], str], Both]:
    """What shows depends on what is felt at the same instant."""

    def acts(both: Both, at: Mapping[str, float], on: str) -> Both:
        return _on(both, on, lambda u: lambda t: law(u(t), at["size"]))

    return acts


def _on(both: Both, on: str, made: Callable[[Signal], Signal]) -> Both:
    rate, force = both
    return (made(rate), force) if on == "rate" else (rate, made(force))


def _past(kernel: Callable[[float], tuple[Array, Array]]) -> Callable[[Both, Mapping[str, float], str], Both]:
    """What shows is a weighted sum over ages: `kernel` of the size gives ages (s) and weights."""

    def acts(both: Both, at: Mapping[str, float], on: str) -> Both:
        ages, weights = kernel(at["size"])

        def late(u: Signal) -> Signal:
            return lambda t: np.asarray(
                sum(w * u(t - age) for age, w in zip(ages.tolist(), weights.tolist(), strict=True))
            )

        return _on(both, on, late)

    return acts


def _window(size: float) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(8)
    return 0.5 * size * (nodes + 1.0), 0.5 * weights


def _exponential(size: float) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.laguerre.laggauss(10)
    return size * nodes, weights


def _dead(size: float) -> tuple[Array, Array]:
    return np.array([size]), np.ones(1)


def _early(both: Both, at: Mapping[str, float], on: str) -> Both:
    """All that the device shows comes early: the reference is late."""
    rate, force = both
    return (lambda t: rate(t + at["size"])), (lambda t: force(t + at["size"]))


def _warm(both: Both, at: Mapping[str, float], on: str) -> Both:
    return _on(both, on, lambda u: lambda t: u(t) + at["size"] * np.exp(-t / at["time_constant"]))


# of other axes, and of where a sensor is


def _next(u: Array) -> Array:
    return np.roll(u, -1, axis=0)


def _cross(both: Both, at: Mapping[str, float], on: str) -> Both:
    return _on(both, on, lambda u: lambda t: u(t) + at["size"] * _next(u(t)))


def _by_force(both: Both, at: Mapping[str, float], on: str) -> Both:
    rate, force = both
    return (lambda t: rate(t) + at["size"] * _next(force(t))), force


def _armed(both: Both, at: Mapping[str, float], on: str) -> Both:
    rate, force = both
    arm = at["size"] * np.array([math.cos(at["direction"]), math.sin(at["direction"]), 0.5])

    def felt(t: Array) -> Array:
        w, change = rate(t).T, (rate(t + H) - rate(t - H)).T / (2.0 * H)
        return np.asarray(force(t) + (np.cross(change, arm) + np.cross(w, np.cross(w, arm))).T)

    return rate, felt


def _product(both: Both, at: Mapping[str, float], on: str) -> Both:
    """Each axis shows the product of the two others."""
    return _on(both, on, lambda u: lambda t: u(t) + at["size"] * _next(u(t)) * _next(_next(u(t))))


def _askew(both: Both, at: Mapping[str, float], on: str) -> Both:
    """Axes that are not square to each other: u_x = f_x + yz·u_y − zy·u_z, u_y = f_y + zx·u_z, u_z = f_z."""
    yz, zy, zx = (at["size"] * at[name] for name in ("yz", "zy", "zx"))
    turned = np.linalg.inv(np.array([[1.0, -yz, zy], [0.0, 1.0, -zx], [0.0, 0.0, 1.0]]))
    return _on(both, on, lambda u: lambda t: turned @ u(t))


# strangers


def _echo(both: Both, at: Mapping[str, float], on: str) -> Both:
    return _on(both, on, lambda u: lambda t: (u(t) + at["size"] * u(t - at["after"])) / (1.0 + at["size"]))


def _level_delay(both: Both, at: Mapping[str, float], on: str) -> Both:
    """The faster, the later: u(t − size·|u|)."""

    def made(u: Signal) -> Signal:
        def shown(t: Array) -> Array:
            late = at["size"] * np.abs(u(t))
            slope = (u(t + H) - u(t - H)) / (2.0 * H)
            return np.asarray(u(t) - late * slope)

        return shown

    return _on(both, on, made)


def _wave(both: Both, at: Mapping[str, float], on: str) -> Both:
    """Differential nonlinearity: a wave over the range of the converter, with a period in SI."""
    return _on(both, on, lambda u: lambda t: u(t) + at["size"] * np.sin(2.0 * math.pi * u(t) / at["period"]))


def _follows(both: Both, at: Mapping[str, float], on: str) -> Both:
    """The zero follows the size of the motion of the last seconds."""
    ages = at["memory"] * (np.arange(12) + 0.5) / 12.0
    return _on(
        both, on, lambda u: lambda t: u(t) + at["size"] * sum(np.abs(u(t - age)) for age in ages.tolist()) / 12.0
    )


def _butterworth(frequency: Array, at: Mapping[str, float]) -> Array:
    """Four poles at the corner 1/size, by their places on the circle (Butterworth 1930)."""
    poles = np.exp(0.5j * math.pi * (1.0 + (2.0 * np.arange(1, 5) - 1.0) / 4.0))
    return np.asarray(np.prod(-poles / (1j * frequency[:, None] * at["size"] - poles), axis=1))


def _bessel(frequency: Array, at: Mapping[str, float]) -> Array:
    return np.array([bessel_three(1.0 / at["size"])(f) for f in frequency.tolist()])


def _log_gain(frequency: Array, at: Mapping[str, float]) -> Array:
    return np.asarray(1.0 + at["size"] * np.log(frequency / 50.0), np.complex128)


def _step_of_gain(frequency: Array, at: Mapping[str, float]) -> Array:
    return np.asarray(1.0 + at["size"] * (frequency > at["above"]), np.complex128)


def _deviated(angle: Array, at: Mapping[str, float], order: int) -> Array:
    return angle + at["size"] * np.sin(order * (angle - at["direction"]))


TURN, EITHER = (0.0, 2.0 * math.pi), (-1.0, 1.0)
STATIC = ("rotation", "motion", "sweep", "poses")
RESPONSE = ("response",)
LAWS: tuple[Law, ...] = (
    Law("encoder_eccentricity", ("rotation",), (1e-6, 0.1), None, {"direction": TURN},
        shown=lambda angle, at: _deviated(angle, at, 1)),
    Law("encoder_second_harmonic", ("rotation",), (1e-6, 0.1), None, {"direction": TURN},
        shown=lambda angle, at: _deviated(angle, at, 2)),
    Law("reference_delay", ("motion",), (1e-6, 0.2), _early),
    Law("asymmetry", STATIC, (1e-7, 0.2), _static(lambda u, k: u + k * np.abs(u))),
    Law("quadratic", STATIC, (1e-8, 0.2), _static(lambda u, k: u + k * u**2)),
    Law("cubic", (*STATIC, "response"), (1e-8, 0.2), _static(lambda u, k: u + k * u**3)),
    Law("odd_quadratic", ("rotation", "sweep"), (1e-8, 0.2), _static(lambda u, k: u + k * u * np.abs(u))),
    Law("dead_zone", ("rotation", "sweep"), (1e-7, 0.3),
        _static(lambda u, k: np.sign(u) * np.maximum(np.abs(u) - k, 0.0))),
    Law("delay", ("rotation", "motion", "response", "sweep"), (1e-8, 0.2), _past(_dead)),
    Law("first_order_lag", ("rotation", "motion", "response"), (1e-8, 0.1), _past(_exponential)),
    Law("moving_average", ("rotation", "motion", "response"), (1e-8, 0.3), _past(_window)),
    Law("butterworth_filter", RESPONSE, (1e-7, 1e-2), response=_butterworth),
    Law("bessel_filter", RESPONSE, (1e-7, 1e-2), response=_bessel),
    Law("non_orthogonality", ("poses",), (1e-7, 0.2), _askew, {"yz": EITHER, "zy": EITHER, "zx": EITHER}),
    Law("cross_axis", ("motion", "poses"), (1e-6, 0.2), _cross),
    Law("g_sensitivity", ("motion",), (1e-7, 0.1), _by_force, on=("rate",)),
    Law("lever_arm", ("motion",), (1e-5, 2.0), _armed, {"direction": TURN}, on=("acceleration",)),
    Law("warm_up", ("rotation", "motion"), (1e-5, 2.0), _warm, {"time_constant": (15.0, 60.0)}),
    # strangers
    Law("root_bias", ("rotation", "motion"), (1e-7, 0.3), _static(lambda u, k: u + k * np.sqrt(np.abs(u))),
        stranger=True),
    Law("axes_product", ("motion", "poses"), (1e-7, 0.2), _product, stranger=True),
    Law("echo", ("rotation", "motion"), (1e-6, 0.5), _echo, {"after": (0.3, 0.6)}, stranger=True),
    Law("echo_of_millis", RESPONSE, (1e-6, 0.5), _echo, {"after": (0.006, 0.012)}, stranger=True),
    Law("log_gain", RESPONSE, (1e-6, 0.2), response=_log_gain, stranger=True),
    Law("gain_step_in_frequency", RESPONSE, (1e-6, 0.3), None, {"above": (40.0, 100.0)}, response=_step_of_gain,
        stranger=True),
    Law("level_delay", ("rotation", "motion"), (1e-8, 0.1), _level_delay, stranger=True),
    Law("converter_wave", ("rotation", "motion", "poses"), (1e-7, 1.0), _wave, {"period": (1.5, 3.0)}, stranger=True),
    Law("motion_zero", ("rotation", "motion"), (1e-6, 0.5), _follows, {"memory": (5.0, 15.0)}, stranger=True),
)  # fmt: skip


def law_of(name: str) -> Law:
    """The law of that name; raises KeyError."""
    return {one.name: one for one in LAWS}[name]


def names(kind: str, *, stranger: bool = False) -> tuple[str, ...]:
    """What can be hidden in records of a kind."""
    return tuple(one.name for one in LAWS if kind in one.kinds and one.stranger == stranger)


def sized(at: Mapping[str, Any], size: float) -> dict[str, Any]:
    """The same parameters with another size."""
    return {**at, "size": size}
