"""Krohn-Hite 3750R: a filter without remote control. The operator sets it, a measurement says what it really is.

No bytes travel. `configure` shows a card and keeps who confirmed what; `verify` compares the complex response at three
frequencies with the nominal one and fits the true cut-off; `response` then gives the measured filter, and before that
the nominal one, and `status` says which.

No manual of the 3750R was found. That it has 4 poles, a range of 0.02 Hz to 20 kHz, gains of 0 and 20 dB, and that
"low-Q" means four equal real poles at the dial's frequency are common statements about its class, not documented
facts (verify on the bench: `verify` refuses a filter that differs).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from rig.errors import SettingRefused, VerdictNotMet
from rig.record import Identity
from rig.room import Confirmation, Request, Room, Value
from rig.units import Angle, Frequency, Ratio

MODES = ("low-pass", "bypass")
RESPONSES = ("butterworth", "low-q")
GAINS = (0.0, 20.0)  # dB
PROBES = (0.1, 0.5, 1.0)
"""Frequencies of the verification, as shares of the cut-off."""

ADDRESS = "the front panel"


def card(mode: str, cutoff: float, response: str, gain_db: float) -> Request:
    """What the operator is asked: the card's text and the same in SI."""
    text = f"Set the filter to {mode} {cutoff:g} Hz, {response}, gain {gain_db:g} dB."
    settings: dict[str, Value] = {"mode": mode, "cutoff": cutoff, "response": response, "gain_db": gain_db}
    return Request("set_filter", text, settings)


MESSAGES: tuple[str, ...] = ("set_filter",)
"""Actions asked of the operator: all that this driver can 'send'."""

REQUESTS: tuple[Request, ...] = (
    card("low-pass", 5000.0, "butterworth", 0.0),
    card("low-pass", 1000.0, "low-q", 20.0),
    card("bypass", 5000.0, "butterworth", 0.0),
)
"""The same with representative settings."""


class Settings(BaseModel):
    """`serial` from the plate; the limits are those of `verify`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    serial: str
    lowest: Frequency = Field(default=0.02, gt=0, description="lowest cut-off the dial has")
    highest: Frequency = Field(default=20_000.0, gt=0, description="highest cut-off the dial has")
    dial_limit: Ratio = Field(default=0.10, gt=0, lt=0.5, description="largest error of the dial that is accepted")
    gain_limit: Ratio = Field(default=0.03, gt=0, description="largest departure from the fitted response, magnitude")
    phase_limit: Angle = Field(default=math.radians(3.0), gt=0, description="the same for the phase")


@dataclass(frozen=True)
class Setting:
    """What the operator confirmed; cut-off in Hz, gain in dB."""

    mode: str
    cutoff: float
    response: str
    gain_db: float

    @property
    def gain(self) -> float:
        """Nominal gain in the pass band, V/V; bypass goes round the amplifier too (inferred)."""
        return 1.0 if self.mode == "bypass" else float(10.0 ** (self.gain_db / 20.0))


@dataclass(frozen=True)
class Verification:
    """What the measurement at three frequencies says.

    `frequency` Hz, `measured` and `nominal` complex V/V, in the same order. `cutoff` (Hz) and `gain` (V/V) are fitted,
    `dial_error` is cutoff over the dial's value minus one. `magnitude_error` (relative) and `phase_error` (rad) are
    the largest departures of the measured points from the fitted response.
    """

    frequency: tuple[float, ...]
    measured: tuple[complex, ...]
    nominal: tuple[complex, ...]
    cutoff: float
    gain: float
    dial_error: float
    magnitude_error: float
    phase_error: float

    def __str__(self) -> str:
        departures = f"{self.magnitude_error:.2%} and {math.degrees(self.phase_error):.2f}° from the fitted response"
        return f"cut-off {self.cutoff:.1f} Hz (dial {self.dial_error:+.2%}), gain {self.gain:.4f}, within {departures}"


def shape(mode: str, response: str, x: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Complex response for unit gain at x = frequency ÷ cut-off, shape of x.

    Butterworth, 4 poles: H = 1/[(s² + 0.7654 s + 1)(s² + 1.8478 s + 1)], s = jx; low-q: H = 1/(1 + s)⁴.
    """
    s = 1j * np.asarray(x, float)
    if mode == "bypass":
        return np.ones_like(s)
    if response == "low-q":
        return np.asarray(1.0 / (1.0 + s) ** 4)
    # 2 sin(π/8) and 2 cos(π/8), of which 0.7654 and 1.8478 are the four-digit values
    narrow, wide = 2.0 * math.sin(math.pi / 8.0), 2.0 * math.cos(math.pi / 8.0)
    return np.asarray(1.0 / ((s * s + narrow * s + 1.0) * (s * s + wide * s + 1.0)))


def fit_cutoff(
    setting: Setting, frequency: NDArray[np.float64], measured: NDArray[np.complex128]
) -> tuple[float, float]:
    """Cut-off (Hz) and real gain (V/V) that bring the setting's shape closest to the points (least squares).

    The gain is linear and solved for at each cut-off; the cut-off is found by a search over ± an octave of the dial
    that is narrowed until it is a millionth wide.
    """

    def best(cutoff: float) -> tuple[float, float]:
        model = shape(setting.mode, setting.response, frequency / cutoff)
        gain = float(np.real(np.vdot(model, measured)) / np.real(np.vdot(model, model)))
        return float(np.sum(np.abs(measured - gain * model) ** 2)), gain

    if setting.mode == "bypass":
        return setting.cutoff, best(setting.cutoff)[1]
    centre, width = math.log(setting.cutoff), math.log(2.0)
    while width > 1e-6:
        grid = np.linspace(centre - width, centre + width, 41)
        centre = float(grid[int(np.argmin([best(math.exp(c))[0] for c in grid]))])
        width /= 10.0
    cutoff = math.exp(centre)
    return cutoff, best(cutoff)[1]


class KrohnHite3750R:
    """The filter that a person sets. `status` is "unset", "nominal" (confirmed) or "measured" (verified)."""

    def __init__(self, name: str, settings: Settings, room: Room) -> None:
        self._name, self._settings, self._room = name, settings, room
        self._setting: Setting | None = None
        self.confirmation: Confirmation | None = None
        self.verification: Verification | None = None

    @property
    def status(self) -> Literal["unset", "nominal", "measured"]:
        if self._setting is None:
            return "unset"
        return "nominal" if self.verification is None else "measured"

    def identify(self) -> Identity:
        """From the plate and the bench file: there is nothing to ask."""
        return Identity("Krohn-Hite", "3750R", self._settings.serial, "none; set by hand")

    def configure(
        self, mode: str = "low-pass", cutoff: float = 5000.0, response: str = "butterworth", gain_db: float = 0.0
    ) -> Confirmation:
        """Have the operator set the filter; cut-off in Hz. What was verified before no longer counts.

        Raises SettingRefused (the filter does not have it: nobody is asked), OperatorRefused, OperatorMissing.
        """
        self._refuse_bad(mode, cutoff, response, gain_db)
        self._setting = self.verification = self.confirmation = None  # whatever happens now, the old state is gone
        self.confirmation = self._room.operator.ask(card(mode, cutoff, response, gain_db))
        self._setting = Setting(mode, cutoff, response, gain_db)
        return self.confirmation

    def verify(self, measure: Callable[[float], complex]) -> Verification:
        """Compare with the nominal response at a tenth, a half and the whole of the cut-off.

        `measure` gives the complex response (output ÷ input) at a frequency in Hz. Raises VerdictNotMet with the
        reason; the status then stays nominal.
        """
        setting = self._confirmed()
        self.verification = None
        frequency = np.array([share * setting.cutoff for share in PROBES])
        measured = np.array([measure(float(f)) for f in frequency], np.complex128)
        result = self._compared(setting, frequency, measured)
        self._judge(result, setting)
        self.verification = result
        return result

    def response(self, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Complex response (V/V) at frequencies in Hz, same shape: the fitted one if verified, else the nominal one."""
        setting = self._confirmed()
        cutoff, gain = setting.cutoff, setting.gain
        if self.verification is not None:
            cutoff, gain = self.verification.cutoff, self.verification.gain
        return gain * shape(setting.mode, setting.response, np.asarray(frequency, float) / cutoff)

    def settings(self) -> dict[str, str | float | int | bool]:
        """What was confirmed, by whom and when (bench clock, s), and what was measured."""
        values: dict[str, str | float | int | bool] = {"status": self.status}
        if self._setting is not None:
            values |= vars(self._setting)
        if self.confirmation is not None:
            values |= {"confirmed_by": self.confirmation.who, "confirmed_at": self.confirmation.when}
        if self.verification is not None:
            values |= {"measured_cutoff": self.verification.cutoff, "measured_gain": self.verification.gain}
        return values

    def close(self) -> None:
        """Nothing to close."""

    def _compared(
        self, setting: Setting, frequency: NDArray[np.float64], measured: NDArray[np.complex128]
    ) -> Verification:
        if not np.all(np.isfinite(measured)) or np.any(measured == 0):
            raise VerdictNotMet(f"{self._name}: found {measured.tolist()}, wanted a finite response at {frequency} Hz")
        cutoff, gain = fit_cutoff(setting, frequency, measured)
        fitted = gain * shape(setting.mode, setting.response, frequency / cutoff)
        nominal = setting.gain * shape(setting.mode, setting.response, frequency / setting.cutoff)
        departures = measured / fitted if gain else np.full(len(measured), np.inf, complex)
        return Verification(
            frequency=tuple(frequency.tolist()),
            measured=tuple(measured.tolist()),
            nominal=tuple(nominal.tolist()),
            cutoff=cutoff,
            gain=gain,
            dial_error=cutoff / setting.cutoff - 1.0,
            magnitude_error=float(np.max(np.abs(np.abs(departures) - 1.0))),
            phase_error=max(abs(cmath.phase(complex(value))) for value in departures),
        )

    def _judge(self, result: Verification, setting: Setting) -> None:
        limits = self._settings
        checks = (
            ("dial error", abs(result.dial_error), limits.dial_limit),
            ("gain error", abs(result.gain / setting.gain - 1.0), limits.gain_limit),
            ("departure in magnitude", result.magnitude_error, limits.gain_limit),
        )
        found = [f"{what} {value:.1%}, wanted at most {limit:.1%}" for what, value, limit in checks if value > limit]
        if result.phase_error > limits.phase_limit:
            degrees = math.degrees(result.phase_error), math.degrees(limits.phase_limit)
            found.append(f"departure in phase {degrees[0]:.1f}°, wanted at most {degrees[1]:.1f}°")
        if found:
            raise VerdictNotMet(f"{self._name} set to {_shown(setting)}: found {'; '.join(found)}")

    def _confirmed(self) -> Setting:
        if self._setting is None:
            raise SettingRefused(self._name, ADDRESS, wanted="a setting that the operator has confirmed")
        return self._setting

    def _refuse_bad(self, mode: str, cutoff: float, response: str, gain_db: float) -> None:
        low, high = self._settings.lowest, self._settings.highest
        wrong = [
            f"{what} {wanted}, found {found}"
            for what, good, wanted, found in (
                ("mode", mode in MODES, " or ".join(MODES), mode),
                ("response", response in RESPONSES, " or ".join(RESPONSES), response),
                ("gain", gain_db in GAINS, "0 or 20 dB", gain_db),
                ("cut-off", low <= cutoff <= high, f"{low:g}…{high:g} Hz", cutoff),
            )
            if not good
        ]
        if wrong:
            raise SettingRefused(self._name, ADDRESS, wanted="; ".join(wrong))


def _shown(setting: Setting) -> str:
    return f"{setting.mode} {setting.cutoff:g} Hz, {setting.response}, {setting.gain_db:g} dB"


def connect(name: str, settings: Settings, room: Room) -> KrohnHite3750R:
    """Nothing is opened."""
    return KrohnHite3750R(name, settings, room)
