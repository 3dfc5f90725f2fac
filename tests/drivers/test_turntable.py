"""The turntable: what the operator is asked, and when the gate opens."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import turntable
from drivers.turntable import LINES, MESSAGES, REQUESTS, RPM, Gate, Limits, Revolution, Settings, revolutions, stopped
from fixtures.world import World
from rig.errors import SettingRefused, VerdictNotMet
from rig.room import Confirmation, Request, Room

SAMPLING = 1.0 / 3125.0


class Person:
    """An operator who keeps every card, and a clock that stands still."""

    def __init__(self) -> None:
        self.cards: list[Request] = []

    def ask(self, request: Request) -> Confirmation:
        self.cards.append(request)
        return Confirmation(request, "A. Technician", self.now())

    def now(self) -> float:
        return 1.8e9

    def sleep(self, seconds: float) -> None:
        return None


def table(**values: Any) -> tuple[turntable.Turntable, Person]:
    person = Person()
    return turntable.connect("platter", Settings.model_validate(values), Room(clock=person, operator=person)), person


def turning(rpm: float, turns: int, *, wow: float = 0.0, slope: float = 0.0, sampled: bool = True) -> tuple[Any, Any]:
    """Line edges and index pulses (s) of a platter at `rpm` with once-per-revolution wow (peak) and drift per turn."""
    lines = np.arange(turns * LINES + 2)
    turned = lines / LINES  # revolutions
    rate = rpm / 60.0 * (1 + wow * np.sin(2 * np.pi * turned) + slope * turned)
    times = np.concatenate([[0.0], np.cumsum(1.0 / LINES / ((rate[1:] + rate[:-1]) / 2))]) + 0.1234
    index = times[::LINES] - 0.25 / LINES / (rpm / 60.0)
    if sampled:  # seen with the converter's eyes: half a sample before the first sample behind the edge
        times = (np.ceil(times / SAMPLING) - 0.5) * SAMPLING
        index = (np.ceil(index / SAMPLING) - 0.5) * SAMPLING
    return times, index


def turns_at(rpm: float, count: int, **shape: Any) -> list[Revolution]:
    return revolutions(*turning(rpm, count, **shape), direction=-1)


def fed(gate: Gate, turned: Sequence[Revolution]) -> list[str]:
    return [gate.feed(one).state for one in turned]


# --- the operator -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rpm", "text"), [(100 / 3, "Start the platter at 33.33 rpm."), (45.0, "Start the platter at 45 rpm.")]
)
def test_the_operator_is_asked_for_the_speed(rpm: float, text: str) -> None:
    platter, person = table()
    platter.set_speed(rpm)
    assert [(card.action, card.text, dict(card.settings)) for card in person.cards] == [
        ("turntable_speed", text, {"rpm": rpm})
    ]
    assert platter.settings()["confirmed_by"] == "A. Technician"


def test_stopping_is_a_speed_too() -> None:
    platter, person = table()
    platter.set_speed(0.0)
    assert dict(person.cards[0].settings) == {"rpm": 0.0}


@pytest.mark.parametrize("rpm", [78.0, 33.3, -45.0, math.nan])
def test_a_speed_the_selector_does_not_have_is_refused_and_nobody_is_asked(rpm: float) -> None:
    platter, person = table()
    with pytest.raises(SettingRefused, match="100/3 rpm, 45 rpm or 0"):
        platter.set_speed(rpm)
    assert person.cards == []


def test_every_request_is_one_of_the_actions() -> None:
    assert {request.action for request in REQUESTS} == set(MESSAGES)


# --- revolutions from edges -------------------------------------------------------------------------------------------


def test_a_whole_revolution_gives_the_mean_rate_whatever_the_wow() -> None:
    for one in turns_at(45.0, 4, wow=0.002):
        assert one.lines == LINES
        assert one.rate == pytest.approx(-45.0 * RPM, rel=5e-4)
        assert one.wow == pytest.approx(0.002 * math.sin(math.pi / 8) / (math.pi / 8), abs=7e-4)


def test_a_missed_index_is_told_from_a_wrong_count() -> None:
    edges, index = turning(45.0, 6)
    found = revolutions(edges, np.delete(index, 2), direction=-1)
    assert [one.lines for one in found] == [1000] * 6
    assert [one.missed for one in found] == [False, True, False, False, False, False]
    slipped = revolutions(np.delete(edges, 1500), index, direction=-1)
    assert [one.lines for one in slipped] == [1000, 999, 1000, 1000, 1000, 1000]


def test_edges_without_an_index_give_no_revolution() -> None:
    edges, index = turning(45.0, 2)
    assert revolutions(edges, index[:1], direction=-1) == []
    assert revolutions(edges[:0], index, direction=-1) == []


@given(
    st.lists(st.floats(0, 100), max_size=30, unique=True).map(sorted),
    st.lists(st.floats(0, 100), max_size=6, unique=True).map(sorted),
)
def test_any_edges_and_indices_give_revolutions_in_order(edges: list[float], index: list[float]) -> None:
    found = revolutions(np.array(edges), np.array(index), direction=1)
    assert all(one.begin < one.end for one in found)
    assert all(a.end <= b.begin for a, b in itertools.pairwise(found))


# --- the gate ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rpm", [100 / 3, 45.0])
@pytest.mark.parametrize("offset", [-0.03, 0.0, 0.04])
def test_the_gate_opens_after_five_steady_revolutions_near_nominal(rpm: float, offset: float) -> None:
    gate = Gate(rpm)
    true = rpm * (1 + offset)
    assert fed(gate, turns_at(true, 7, wow=0.002)) == ["waiting"] * 4 + ["steady"] * 3
    assert gate.verdict.rate == pytest.approx(-true * RPM, rel=2e-4)


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        ({"rpm": 100 / 3}, r"33\.3\d rpm, wanted 45\.00 rpm"),
        ({"rpm": 45 * 1.06}, r"47\.[67]\d rpm"),
        ({"rpm": 45, "wow": 0.06}, "wow"),
        ({"rpm": 45, "slope": 0.001}, r"rate changes by \+0\.(09|10)"),
        ({"rpm": 45, "slope": -0.001}, r"rate changes by -0\.(09|10)"),
    ],
)
def test_an_unsteady_platter_keeps_the_gate_shut_and_fails_in_time_with_the_reason(
    shape: dict[str, Any], reason: str
) -> None:
    gate = Gate(45.0)
    assert set(fed(gate, turns_at(count=30, **shape))) == {"waiting"}
    verdict = gate.look(61.0)
    assert verdict.state == "failed"
    assert re.search(reason, verdict.reason)
    assert verdict.reason.endswith("not steady within 60 s")


def test_a_platter_that_does_not_turn_fails_in_time() -> None:
    gate = Gate(45.0, started=100.0)
    assert gate.look(159.0).state == "waiting"
    assert str(gate.look(161.0)) == "failed: no whole revolution yet; not steady within 60 s"


def test_the_wrong_sense_fails_at_once() -> None:
    gate = Gate(45.0)
    edges, index = turning(45.0, 2)
    verdict = gate.feed(revolutions(edges, index, direction=1)[0])
    assert str(verdict) == "failed: turns anticlockwise, wanted clockwise"
    assert gate.feed(turns_at(45.0, 1)[0]).state == "failed"


def test_a_wrong_line_count_starts_the_count_again() -> None:
    gate = Gate(45.0)
    good = turns_at(45.0, 12)
    states = fed(gate, [*good[:4], replace(good[4], lines=900, sectors=()), *good[5:]])
    assert states == ["waiting"] * 9 + ["steady"] * 3


def test_a_few_lost_lines_say_nothing_of_how_steady_the_platter_is() -> None:
    gate = Gate(45.0)
    good = turns_at(45.0, 8)
    assert fed(gate, [*good[:2], replace(good[2], lines=999, sectors=()), *good[3:]])[-1] == "steady"


def test_a_missed_index_is_counted_and_tolerated() -> None:
    edges, index = turning(45.0, 8)
    gate = Gate(45.0)
    assert fed(gate, revolutions(edges, np.delete(index, 3), direction=-1))[-1] == "steady"
    assert gate.verdict.missed_index == 1


def test_revolutions_that_were_not_seen_break_the_run() -> None:
    good = turns_at(45.0, 12)
    assert fed(Gate(45.0), [*good[:4], *good[5:9]]) == ["waiting"] * 8


@given(
    walk=st.lists(st.floats(-0.004, 0.004), min_size=1, max_size=60),
    start=st.floats(0.9, 1.1),
    counts=st.lists(st.sampled_from([1000, 1000, 1000, 1000, 999, 900, 2000, 1]), min_size=60, max_size=60),
    wows=st.lists(st.floats(0, 0.036), min_size=60, max_size=60),
)
def test_whatever_the_platter_does_an_open_gate_means_steady(
    walk: list[float], start: float, counts: list[int], wows: list[float]
) -> None:
    limits = Limits(timeout=40.0)
    gate, time, rate, seen = Gate(45.0, limits=limits), 0.0, start * 45.0 * RPM, []
    failed = False
    for step, lines, wow in zip(walk, counts, wows, strict=False):
        rate *= 1 + step
        end = time + 2 * math.pi / rate
        seen.append(Revolution(time, end, lines, -1, (rate * (1 + wow), rate * (1 - wow))))
        verdict, time = gate.feed(seen[-1]), end
        assert not failed or verdict.state == "failed"
        failed = verdict.state == "failed"
        if verdict.state == "steady":
            last = seen[-5:]
            relative = [abs(one.rate) / (45.0 * RPM) for one in last]
            assert len(last) == 5
            assert all(abs(one.lines - LINES) <= 50 for one in last)
            assert all(one.wow <= limits.wow for one in last if one.lines == LINES)
            assert all(abs(value - 1) <= 0.05 for value in relative)
            assert abs(np.polyfit(range(5), relative, 1)[0] / np.mean(relative)) <= 0.0005 + 1e-12
        if verdict.state == "failed":
            assert verdict.reason
            assert end > 40.0


def test_a_spin_up_with_its_exponential_approach_is_waited_for() -> None:
    """τ = 1.5 s, the family's belt drive: the gate must open, and not before the rate has settled."""
    t = np.arange(0, 40, 1e-4)
    turned = 0.75 * (t - 1.5 * (1 - np.exp(-t / 1.5)))
    edges = np.interp(np.arange(int(turned[-1] * LINES)) / LINES, turned, t)
    found = revolutions(edges, edges[400::LINES] - 1e-4, direction=-1)
    gate = Gate(45.0)
    states = fed(gate, found)
    first = states.index("steady")
    assert found[first].begin > 6.0
    assert abs(found[first - 4].rate) == pytest.approx(45 * RPM, rel=2e-2)
    assert found[first].end < 25.0


# --- waiting, and rest ------------------------------------------------------------------------------------------------


def test_waiting_returns_the_verdict_that_goes_into_the_record() -> None:
    platter, _ = table()
    platter.set_speed(45.0)
    turned = iter(turns_at(45.3, 9))
    verdict = platter.wait_until_steady(lambda: ((one := next(turned)).end, [one]))
    assert verdict.state == "steady"
    assert platter.settings()["gate"] == "steady"


def test_waiting_in_vain_is_a_verdict_with_the_reason() -> None:
    platter, _ = table()
    platter.set_speed(45.0)
    turned = iter(turns_at(100 / 3, 50))
    with pytest.raises(VerdictNotMet, match=r"platter at 45 rpm: found 33.33 rpm, wanted 45.00 rpm ± 5%"):
        platter.wait_until_steady(lambda: ((one := next(turned)).end, [one]))


def test_there_is_no_gate_for_a_standing_platter() -> None:
    platter, _ = table()
    with pytest.raises(SettingRefused, match="above zero"):
        platter.gate()


def test_rest_is_the_absence_of_edges() -> None:
    edges, _ = turning(45.0, 1)
    last = float(edges[-1])
    assert not stopped(edges, last + 0.5)
    assert stopped(edges, last + 2.0)
    assert stopped(np.array([]), 2.0)
    assert not stopped(np.array([]), 1.0)


def test_a_platter_that_still_turns_is_not_at_rest() -> None:
    platter, _ = table()
    edges, _ = turning(45.0, 1)
    platter.require_rest(edges, float(edges[-1]) + 3.0)
    with pytest.raises(VerdictNotMet, match=r"found a line edge 0\.00 s ago"):
        platter.require_rest(edges, float(edges[-1]))


def test_the_simulated_operator_does_everything_that_can_be_asked() -> None:
    world = World({"start": "2026-11-02T08:00:00Z", "mains": "50 Hz"}, seed=1)
    for request in REQUESTS:
        assert isinstance(world.perform(request.action, request.settings, request.text), str)


def edges_of(volts: Any, times: Any) -> Any:
    """Rising edges: half a sample before the first sample above 1.5 V."""
    high = volts > 1.5
    at = np.flatnonzero(high[1:] & ~high[:-1]) + 1
    return (times[at] + times[at - 1]) / 2


def test_in_the_simulated_world_the_gate_opens_after_the_spin_up_and_the_platter_comes_to_rest() -> None:
    world = World({"start": "2026-11-02T08:00:00Z", "mains": "50 Hz"}, seed=2)
    platter, person = table()
    world.perform("cables", {"set": "turntable"}, "")
    platter.set_speed(45.0)
    world.perform(person.cards[-1].action, person.cards[-1].settings, person.cards[-1].text)
    edges, index, now = watched(world, 30.0)
    verdict = platter.wait_until_steady(lambda: (now, revolutions(edges, index, direction=-1)))
    assert verdict.state == "steady"
    assert abs(abs(verdict.rate) / (45 * RPM) - 1) < 0.05
    platter.set_speed(0.0)
    world.perform(person.cards[-1].action, person.cards[-1].settings, person.cards[-1].text)
    world.advance(30.0)
    edges, index, now = watched(world, 3.0)
    platter.require_rest(edges, 3.0)


def watched(world: World, seconds: float) -> tuple[Any, Any, float]:
    """Edges of A and of the index over the next stretch, at the converter's instants (s since the stretch began)."""
    begin, scans = world.now, np.arange(int(seconds / SAMPLING)) * SAMPLING
    world.advance(seconds)
    lines, index = world.volts(["encoder_a", "encoder_index"], [begin + scans + 20e-6, begin + scans + 60e-6])
    return edges_of(lines, scans + 20e-6), edges_of(index, scans + 60e-6), seconds
