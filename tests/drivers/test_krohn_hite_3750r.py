"""The filter that a person sets: the card, the verification by measurement, and the response it gives."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import krohn_hite_3750r
from drivers.krohn_hite_3750r import MESSAGES, REQUESTS, KrohnHite3750R, Settings
from fixtures.world import World
from rig.errors import OperatorRefused, SettingRefused, VerdictNotMet
from rig.room import Confirmation, Request, Room


class Person:
    """An operator who keeps every card, and a clock that stands still."""

    def __init__(self, *, willing: bool = True) -> None:
        self.cards: list[Request] = []
        self.willing = willing

    def ask(self, request: Request) -> Confirmation:
        self.cards.append(request)
        if not self.willing:
            raise OperatorRefused("no")
        return Confirmation(request, "A. Technician", self.now(), "dial 5.0 × 1k")

    def now(self) -> float:
        return 1.8e9

    def sleep(self, seconds: float) -> None:
        return None


def filter_and_person(*, willing: bool = True) -> tuple[KrohnHite3750R, Person]:
    person = Person(willing=willing)
    settings = Settings.model_validate({"serial": "1234"})
    return krohn_hite_3750r.connect("filter", settings, Room(clock=person, operator=person)), person


def butterworth(f: float, cutoff: float) -> complex:
    """Written from the pole positions: s_k = exp(jπ(2k + 5)/8) for k = 0…3."""
    s = 1j * f / cutoff
    value = 1.0 + 0j
    for k in range(4):
        pole = np.exp(1j * math.pi * (2 * k + 5) / 8)
        value *= -pole / (s - pole)
    return complex(value)


def real_filter(cutoff: float, gain: float = 1.0) -> Callable[[float], complex]:
    return lambda f: gain * butterworth(f, cutoff)


def test_the_operator_is_shown_the_card_and_the_confirmation_is_kept() -> None:
    instrument, person = filter_and_person()
    confirmation = instrument.configure(mode="low-pass", cutoff=5000.0, response="butterworth", gain_db=0.0)
    (card,) = person.cards
    assert card.action == "set_filter"
    assert card.text == "Set the filter to low-pass 5000 Hz, butterworth, gain 0 dB."
    assert card.settings == {"mode": "low-pass", "cutoff": 5000.0, "response": "butterworth", "gain_db": 0.0}
    assert (confirmation.who, confirmation.said) == ("A. Technician", "dial 5.0 × 1k")
    assert instrument.settings()["confirmed_by"] == "A. Technician"
    assert instrument.status == "nominal"


@pytest.mark.parametrize(
    "wrong",
    [
        {"mode": "high-pass"},
        {"cutoff": 0.0},
        {"cutoff": 30_000.0},
        {"cutoff": math.nan},
        {"response": "bessel"},
        {"gain_db": 10.0},
    ],
)
def test_a_setting_the_filter_does_not_have_is_refused_and_nobody_is_asked(wrong: dict[str, object]) -> None:
    instrument, person = filter_and_person()
    with pytest.raises(SettingRefused, match="found"):
        instrument.configure(**wrong)  # type: ignore[arg-type]
    assert person.cards == []


def test_a_refusing_operator_leaves_the_filter_unset() -> None:
    instrument, _ = filter_and_person(willing=False)
    with pytest.raises(OperatorRefused):
        instrument.configure()
    assert instrument.status == "unset"
    with pytest.raises(SettingRefused, match="confirmed"):
        instrument.response(np.array([100.0]))


@pytest.mark.parametrize(
    ("x", "magnitude", "degrees"), [(0.05, 1.0, -7.5), (0.1, 1.0, -15.0), (0.5, 0.998, -78.0), (1.0, 0.70711, -180.0)]
)
def test_the_nominal_response_is_the_four_pole_butterworth(x: float, magnitude: float, degrees: float) -> None:
    instrument, _ = filter_and_person()
    instrument.configure(cutoff=2000.0)
    (value,) = instrument.response(np.array([x * 2000.0]))
    assert abs(value) == pytest.approx(magnitude, abs=2e-4)
    assert abs(math.degrees(np.angle(value * np.exp(-1j * math.radians(degrees))))) < 0.1
    assert value == pytest.approx(butterworth(x, 1.0), rel=1e-12)


@given(error=st.floats(-0.09, 0.09), gain=st.floats(0.98, 1.02), cutoff=st.sampled_from([100.0, 1000.0, 5000.0]))
def test_verification_finds_the_true_cut_off_and_the_response_follows(error: float, gain: float, cutoff: float) -> None:
    instrument, _ = filter_and_person()
    instrument.configure(cutoff=cutoff)
    result = instrument.verify(real_filter(cutoff * (1 + error), gain))
    assert instrument.status == "measured"
    assert result.frequency == pytest.approx((cutoff / 10, cutoff / 2, cutoff))
    assert result.dial_error == pytest.approx(error, abs=1e-6)
    assert result.gain == pytest.approx(gain, abs=1e-5)
    (value,) = instrument.response(np.array([0.3 * cutoff]))
    assert value == pytest.approx(gain * butterworth(0.3 / (1 + error), 1.0), rel=1e-5)


def test_noise_of_a_part_in_a_thousand_moves_the_cut_off_by_about_as_much() -> None:
    rng = np.random.default_rng(5)
    true = real_filter(5150.0)
    instrument, _ = filter_and_person()
    instrument.configure()
    result = instrument.verify(lambda f: true(f) * (1 + 1e-3 * complex(rng.normal(), rng.normal())))
    assert result.dial_error == pytest.approx(0.03, abs=1e-3)
    assert "dial +3.0" in str(result)


@pytest.mark.parametrize(
    ("measure", "reason"),
    [
        (real_filter(5800.0), "dial error 16.0 %|dial error 16.0%"),
        (real_filter(5000.0, 1.1), "gain error"),
        (real_filter(5000.0, 10.0), "gain error"),
        (lambda f: 1.0 + 0j, "departure"),
        (lambda f: 1 / (1 + 1j * f / 5000.0), "departure"),
        (lambda f: complex("nan"), "finite response"),
        (lambda f: 0j, "finite response"),
    ],
)
def test_a_filter_that_is_not_what_was_asked_for_is_refused(measure: Callable[[float], complex], reason: str) -> None:
    instrument, _ = filter_and_person()
    instrument.configure()
    with pytest.raises(VerdictNotMet, match=reason):
        instrument.verify(measure)
    assert instrument.status == "nominal"


def test_a_new_setting_makes_the_old_verification_worthless() -> None:
    instrument, _ = filter_and_person()
    instrument.configure()
    instrument.verify(real_filter(5100.0))
    instrument.configure(cutoff=1000.0)
    assert instrument.status == "nominal"
    assert "measured_cutoff" not in instrument.settings()


def test_bypass_passes_everything_as_it_is() -> None:
    instrument, _ = filter_and_person()
    instrument.configure(mode="bypass", gain_db=20.0)
    assert instrument.response(np.array([1.0, 1e4])) == pytest.approx([1.0, 1.0])
    instrument.verify(lambda f: 1.005 + 0j)
    assert instrument.response(np.array([1.0, 1e4])) == pytest.approx([1.005, 1.005])


def test_the_plate_stands_in_for_an_identity() -> None:
    instrument, _ = filter_and_person()
    assert str(instrument.identify()) == "Krohn-Hite 3750R (serial 1234, firmware none; set by hand)"


def test_every_request_is_one_of_the_actions() -> None:
    assert {request.action for request in REQUESTS} == set(MESSAGES)


def test_the_simulated_operator_does_everything_that_can_be_asked() -> None:
    world = World({"start": "2026-11-02T08:00:00Z", "mains": "50 Hz"}, seed=1)
    for request in REQUESTS:
        assert isinstance(world.perform(request.action, request.settings, request.text), str)


@pytest.mark.parametrize("response", ["butterworth", "low-q"])
def test_in_the_simulated_world_verification_finds_the_dials_true_error(response: str) -> None:
    world = World({"start": "2026-11-02T08:00:00Z", "mains": "50 Hz"}, seed=3)
    instrument, person = filter_and_person()
    instrument.configure(cutoff=1000.0, response=response)
    world.perform(person.cards[0].action, person.cards[0].settings, person.cards[0].text)
    world.perform("filter_test", {"on": True}, "")

    def measure(frequency: float) -> complex:
        """Both sides of the filter, one second, at 50 kHz; the ratio of their Fourier coefficients."""
        world.set_source(frequency=frequency, level=1.0, on=True)
        world.advance(0.5)
        times = world.now + np.arange(50_000) / 50_000.0
        world.advance(1.0)
        before, after = world.volts(["source", "filter_output"], [times, times])
        wave = np.exp(-2j * np.pi * frequency * times)
        return complex((after @ wave) / (before @ wave))

    result = instrument.verify(measure)
    assert result.dial_error == pytest.approx(world.truth["filter_dial_error"], abs=2e-3)
    assert instrument.status == "measured"
