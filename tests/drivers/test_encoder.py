"""The encoder's lines, direction and index, out of coarse samples of TTL levels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.encoder import Encoder
from rig.record import Channel, Samples, Timing
from rig.signals.encoder import Decoder, Lines, Settings, Trigger, decode, edges

TIMING = Timing(20e-6, 16)
CHANNELS = tuple(
    Channel(name, slot, -10.0, 10.0) for slot, name in ((1, "encoder_a"), (2, "encoder_b"), (3, "encoder_index"))
)
FORWARD = Settings(a_leads=1)


@dataclass(frozen=True)
class Disk:
    """An encoder as the data sheet allows it; everything in lines (1 is 360 °e)."""

    phase: float = 0.3
    a_width: float = 0.5
    b_width: float = 0.5
    b_delay: float = 0.25  # from the middle of A's pulse to the middle of B's
    index_width: float = 0.25

    def levels(self, name: str, lines: NDArray[np.float64]) -> NDArray[np.bool_]:
        if name == "encoder_a":
            return np.mod(lines, 1.0) < self.a_width
        if name == "encoder_b":
            begin = self.a_width / 2 + self.b_delay - self.b_width / 2
            return np.mod(lines - begin, 1.0) < self.b_width
        return np.mod(lines - 0.875 + self.index_width / 2, 1000.0) < self.index_width

    @property
    def states(self) -> tuple[float, ...]:
        begin = self.a_width / 2 + self.b_delay - self.b_width / 2
        return begin, self.a_width - begin, begin + self.b_width - self.a_width, 1.0 - begin - self.b_width


def sampled(disk: Disk, rpm: float, scans: int, noise: float = 0.01, first: int = 0) -> Samples:
    """Constant rate; negative rpm turns so that B leads."""
    random = np.random.default_rng(7)
    columns = []
    for channel in CHANNELS:
        lines = disk.phase + rpm / 60.0 * 1000.0 * TIMING.instants(channel.slot, scans, first)
        volts = np.where(disk.levels(channel.name, lines), 4.0, 0.2) + noise * random.standard_normal(scans)
        columns.append(np.rint((volts + 10.0) / 20.0 * 65535.0))
    return Samples(np.column_stack(columns).astype(np.uint16), CHANNELS, TIMING, 0.0, first)


def rising_edges(disk: Disk, rpm: float, scans: int) -> int:
    """How many times A really rises between its first and its last sample."""
    begin, end = disk.phase + rpm / 60.0 * 1000.0 * TIMING.instants(1, scans)[[0, -1]]
    if rpm > 0:
        return math.floor(end) - math.floor(begin)
    return math.ceil(begin - disk.a_width) - math.ceil(end - disk.a_width)


def joined(parts: list[Lines]) -> NDArray[np.float64]:
    return np.concatenate([part.edges for part in parts])


def test_an_edge_lies_between_the_last_low_and_the_first_high_sample() -> None:
    assert edges(np.array([0.2, 0.2, 4.0, 4.0]), np.array([0.0, 1.0, 2.0, 3.0])).tolist() == [1.5]


def test_a_sample_on_the_edge_is_the_edge() -> None:
    assert edges(np.array([0.2, 0.2, 1.6, 4.0]), np.array([0.0, 1.0, 2.0, 3.0])).tolist() == [2.0]


def test_noise_between_the_thresholds_makes_no_edges() -> None:
    volts = np.array([0.2, 1.5, 1.1, 1.9, 0.3, 1.4, 4.0, 1.5, 3.9])
    assert edges(volts, np.arange(9.0)).tolist() == [5.0]


def test_a_trigger_that_starts_high_waits_for_a_low() -> None:
    pulses = Trigger(1.0, 2.0).feed(np.array([4.0, 0.1, 4.0]), np.arange(3.0))
    assert pulses.rising.tolist() == [1.5]
    assert pulses.falling.tolist() == [0.5]


@given(st.lists(st.sampled_from([0.1, 1.5, 4.0]), max_size=60), st.lists(st.integers(0, 60), max_size=5))
def test_a_trigger_sees_the_same_in_pieces(levels: list[float], cuts: list[int]) -> None:
    volts, instants = np.array(levels, float), np.arange(float(len(levels)))
    whole = Trigger(1.0, 2.0).feed(volts, instants)
    trigger = Trigger(1.0, 2.0)
    bounds = sorted(min(cut, len(levels)) for cut in cuts)
    pieces = [trigger.feed(v, t) for v, t in zip(np.split(volts, bounds), np.split(instants, bounds), strict=True)]
    assert np.concatenate([piece.rising for piece in pieces]).tolist() == whole.rising.tolist()
    assert sum(piece.between for piece in pieces) == whole.between


@settings(max_examples=60, deadline=None)
@given(
    rpm=st.floats(10.0, 46.0),
    forward=st.booleans(),
    phase=st.floats(0.0, 999.999),
    a_error=st.floats(-30.0, 30.0),
    b_error=st.floats(-30.0, 30.0),
    phase_error=st.floats(-15.0, 15.0),
)
def test_any_rate_phase_and_duty_give_the_exact_line_count_and_the_direction(
    rpm: float, forward: bool, phase: float, a_error: float, b_error: float, phase_error: float
) -> None:
    disk = Disk(phase, 0.5 + a_error / 360, 0.5 + b_error / 360, 0.25 + phase_error / 360)
    assume(min(disk.states) >= 60.0 / 360.0)
    signed = rpm if forward else -rpm
    lines = decode(sampled(disk, signed, 3000), FORWARD)
    assert len(lines.edges) == rising_edges(disk, signed, 3000)
    assert set(lines.direction.tolist()) == {1 if forward else -1}
    mean = (len(lines.edges) - 1) / (lines.edges[-1] - lines.edges[0])
    assert mean == pytest.approx(rpm / 60.0 * 1000.0, rel=2e-3)


@settings(max_examples=40, deadline=None)
@given(
    rpm=st.floats(10.0, 46.0),
    forward=st.booleans(),
    phase=st.floats(0.0, 999.999),
    width=st.floats(60.0, 120.0),
    chunk=st.integers(500, 9000),
)
def test_every_index_interval_closes_whatever_the_rate_and_the_width_of_the_pulse(
    rpm: float, forward: bool, phase: float, width: float, chunk: int
) -> None:
    disk = Disk(phase, index_width=width / 360.0)
    signed = rpm if forward else -rpm
    scans = math.ceil(3.2 * 60.0 / rpm * TIMING.scan_rate)
    samples = sampled(disk, signed, scans)
    decoder = Decoder(FORWARD)
    parts = []
    for first in range(0, scans, chunk):
        piece = samples.counts[first : first + chunk]
        one = Samples(piece, CHANNELS, TIMING, 0.0, first)
        parts.append(decoder.feed(one, final=first + chunk >= scans))
    counts = [count for part in parts for count in part.counts]
    assert all(count % 1000 == 0 for count in counts)
    seen = sum(len(part.index) for part in parts)
    assert len(counts) == max(seen - 1, 0)
    assert [count for part in parts for count in part.flagged] == [count for count in counts if count > 2000]
    whole = decode(samples, FORWARD)
    assert joined(parts).tolist() == whole.edges.tolist()
    assert np.concatenate([part.index for part in parts]).tolist() == whole.index.tolist()


def test_a_revolution_takes_the_time_it_takes() -> None:
    lines = decode(sampled(Disk(900.3), 100.0 / 3.0, 6 * 5625), FORWARD)
    durations = np.diff(lines.revolutions, axis=1).ravel()
    assert len(durations) == 5
    assert durations == pytest.approx(1.8, abs=TIMING.scan_period)


def test_an_index_lies_between_the_lines_it_is_counted_between() -> None:
    lines = decode(sampled(Disk(900.3), 45.0, 20_000), FORWARD)
    assert len(lines.index) >= 3
    for time, line in zip(lines.index, lines.index_line, strict=True):
        assert lines.edges[line] < time < lines.edges[line + 1]
    at = np.searchsorted(lines.edges, lines.index)
    assert set(np.diff(at).tolist()) <= {1000, 2000}


def without_index(samples: Samples, pulse: int) -> Samples:
    """The same record with one index pulse gone."""
    counts = samples.counts.copy()
    high = np.flatnonzero(samples.volts("encoder_index") > 2.0)
    groups = np.split(high, np.flatnonzero(np.diff(high) > 10) + 1)
    counts[groups[pulse], 2] = counts[0, 2]
    return Samples(counts, samples.channels, samples.timing, samples.start)


def test_a_missed_index_is_counted_and_its_two_revolutions_are_kept() -> None:
    samples = without_index(sampled(Disk(900.3), 30.0, 5 * 6250), 2)
    lines = decode(samples, FORWARD)
    assert lines.counts == (1000, 2000, 1000)
    assert (lines.missed, lines.flagged) == (1, ())
    assert np.diff(lines.revolutions, axis=1).ravel() == pytest.approx([2.0] * 4, abs=TIMING.scan_period)


def test_a_lost_line_is_flagged_and_never_mended() -> None:
    samples = sampled(Disk(900.3), 30.0, 3 * 6250)
    counts = samples.counts.copy()
    high = np.flatnonzero(samples.volts("encoder_a") > 2.0)
    pulse = high[(high > 3000) & (high < 3010)][:1]
    while samples.volts("encoder_a")[pulse[-1] + 1] > 2.0:
        pulse = np.append(pulse, pulse[-1] + 1)
    while samples.volts("encoder_a")[pulse[0] - 1] > 2.0:
        pulse = np.insert(pulse, 0, pulse[0] - 1)
    counts[pulse, 0] = counts[np.flatnonzero(samples.volts("encoder_a") < 1.0)[0], 0]
    lines = decode(Samples(counts, CHANNELS, TIMING, 0.0), FORWARD)
    assert lines.counts == (999, 1000)
    assert lines.flagged == (999,)
    assert len(lines.revolutions) == 1


def test_a_second_pulse_within_a_line_is_flagged() -> None:
    samples = sampled(Disk(500.0), 10.0, 20_000)
    counts = samples.counts.copy()
    high = np.flatnonzero(samples.volts("encoder_index") > 2.0)
    counts[high[len(high) // 2], 2] = counts[0, 2]  # a drop-out in the middle of the first pulse
    assert 0 in decode(Samples(counts, CHANNELS, TIMING, 0.0), FORWARD).flagged


def test_the_module_facing_the_other_way_turns_the_sense_round() -> None:
    samples = sampled(Disk(), 45.0, 2000)
    assert decode(samples, Settings(a_leads=-1)).sense == -1
    assert decode(samples, Settings(a_leads=1)).sense == 1


def test_a_platter_at_rest_has_no_lines() -> None:
    lines = decode(sampled(Disk(), 0.0, 2000), FORWARD)
    assert (len(lines.edges), len(lines.index), lines.sense) == (0, 0, 0)


def test_spinning_up_from_rest_the_first_revolution_already_closes() -> None:
    scans = 12_000
    columns = []
    for channel in CHANNELS:
        t = TIMING.instants(channel.slot, scans)
        lines = 999.2 + 750.0 * (t - 1.5 * (1.0 - np.exp(-t / 1.5)))
        volts = np.where(Disk().levels(channel.name, lines), 4.0, 0.2)
        columns.append(np.rint((volts + 10.0) / 20.0 * 65535.0))
    samples = Samples(np.column_stack(columns).astype(np.uint16), CHANNELS, TIMING, 0.0)
    lines = decode(samples, FORWARD)
    assert lines.counts[:1] == (1000,)
    assert lines.flagged == ()
    assert set(lines.direction.tolist()) == {1}


def test_a_chunk_that_does_not_follow_is_refused() -> None:
    decoder = Decoder(FORWARD)
    decoder.feed(sampled(Disk(), 45.0, 100))
    with pytest.raises(ValueError, match="from scan 300, wanted one from 100"):
        decoder.feed(sampled(Disk(), 45.0, 100, first=300))


def test_an_hour_of_chunks_keeps_no_more_than_two_revolutions_in_memory() -> None:
    decoder = Decoder(FORWARD)
    total = 0
    for second in range(40):
        lines = decoder.feed(sampled(Disk(100.0), 45.0, 3125, first=3125 * second))
        total += len(lines.edges)
        assert len(decoder._index_count._edges) <= 2100
    assert total == pytest.approx(750 * 40, abs=1)


def test_as_an_instrument_it_says_what_it_is_and_how_it_is_read() -> None:
    encoder = Encoder(Settings(serial="SIM-ENC-1"))
    assert encoder.identify().serial == "SIM-ENC-1"
    read = encoder.settings()
    assert (read["a"], read["low"], read["high"], read["a_leads"], read["lines"]) == ("encoder_a", 1.0, 2.0, -1, 1000)
    assert encoder.decode(sampled(Disk(), 45.0, 2000)).sense == -1
