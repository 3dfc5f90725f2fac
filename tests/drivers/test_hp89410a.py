"""The analyzer's driver over a real socket, through pyvisa, the gateway and the twin."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from pydantic import ValidationError

from drivers import hp89410a
from rig.errors import BadReply, Disconnected, NoAnswer, SettingRefused, WrongIdentity


@pytest.fixture
def analyzer(gpib):
    return gpib.connect(hp89410a)


@pytest.fixture
def ready(analyzer, gpib):
    """Preset, configured, with ranges that hold the signals, and a sine switched on."""
    analyzer.preset()
    analyzer.configure(span=1000.0, points=401, averages=4)
    analyzer.set_range(1, 1.0)
    analyzer.set_range(2, 2.0)
    analyzer.set_sine(100.0, 0.5)
    analyzer.output(True)
    return analyzer


def errors_of(gpib):
    return gpib.do(lambda: list(gpib.twins["hp89410a"].errors))


# ------------------------------------------------------------------------------------------------- the whole language


def test_the_twin_understands_every_message_and_every_question_is_answered(gpib, analyzer) -> None:
    link = analyzer._link
    for message in hp89410a.MESSAGES:
        if ":DATA?" in message:
            assert link.query_block(message)
        elif "?" in message:
            assert link.query(message)
        else:
            link.write(message)
        gpib.sleep(2.0)
        assert errors_of(gpib) == [], message


def test_everything_the_driver_does_is_among_its_messages(gpib, ready) -> None:
    ready.identify()
    ready.measure()
    ready.time_traces()
    ready.autorange()
    ready.zero()
    ready.settings()
    ready.errors()
    ready.overloads()
    ready.make_safe()
    known = {shape(message.encode()) for message in hp89410a.MESSAGES} | {b"++spoll"}
    assert {shape(message) for message in gpib.pages.sent()} <= known
    assert errors_of(gpib) == []


def shape(message: bytes) -> bytes:
    """A message without its numbers."""
    return (
        message.split(b" ")[0]
        if message.startswith(b"++")
        else bytes(c for c in message if chr(c) not in "0123456789.e+-")
    )


# --------------------------------------------------------------------------------------------------------- identity


def test_it_says_who_it_is(analyzer) -> None:
    who = analyzer.identify()
    assert (who.maker, who.model, who.serial, who.firmware) == ("HEWLETT-PACKARD", "89410A", "3416A01211", "A.09.01")


@pytest.mark.parametrize("reply", ["HEWLETT-PACKARD,35670A,0,A.01", "89410A", "HEWLETT-PACKARD,89410A"])
def test_another_instrument_at_its_address_is_a_wrong_identity(gpib, analyzer, reply: str) -> None:
    gpib.plant.faults["hp89410a.identity"] = reply
    with pytest.raises(WrongIdentity, match="wanted an 89410A"):
        analyzer.identify()


def test_connecting_changes_nothing_on_the_instrument(gpib, analyzer) -> None:
    assert gpib.pages.sent() == []


def test_an_unknown_key_in_the_bench_file_is_refused() -> None:
    with pytest.raises(ValidationError):
        hp89410a.Settings.model_validate({"address": "GPIB0::19::INSTR", "colour": "red"})


# ------------------------------------------------------------------------------------------------------- the source


def test_the_level_always_goes_out_in_volts_peak(gpib, analyzer) -> None:
    analyzer.set_sine(79.4328234724, 0.25)
    assert b"FREQ 79.4328234724 HZ;VOLT 0.25 VPK" in gpib.pages.sent()[-1]
    assert (gpib.plant.level, gpib.plant.on) == (0.25, False)
    assert gpib.plant.frequency == pytest.approx(79.4328234724, abs=25e-6)


@pytest.mark.parametrize(
    ("frequency", "amplitude"),
    [
        (0.0, 0.1),
        (-1.0, 0.1),
        (2e7, 0.1),
        (math.nan, 0.1),
        (100.0, -0.1),
        (100.0, 5.001),
        (100.0, math.inf),
        (100.0, math.nan),
    ],
)
def test_a_sine_out_of_range_is_refused_without_sending_anything(gpib, analyzer, frequency, amplitude) -> None:
    with pytest.raises(SettingRefused):
        analyzer.set_sine(frequency, amplitude)
    assert gpib.pages.sent() == []


def test_a_level_the_instrument_limits_is_refused_by_its_error(gpib, analyzer) -> None:
    gpib.do(lambda: gpib.twins["hp89410a"].listen(b"SOUR:VOLT:OFFS 3 V"))
    with pytest.raises(SettingRefused, match="Value out of range"):
        analyzer.set_sine(100.0, 4.0)
    assert errors_of(gpib) == []


def test_the_output_goes_on_and_off(gpib, analyzer) -> None:
    analyzer.output(True)
    assert gpib.plant.on
    analyzer.output(False)
    assert not gpib.plant.on


# ---------------------------------------------------------------------------------------------------------- safety


def test_making_safe_sends_output_off_first_on_a_fresh_connection(gpib, ready) -> None:
    fresh = gpib.connect(hp89410a)
    before = len(gpib.pages.sent())
    fresh.make_safe()
    assert gpib.pages.sent()[before] == b"OUTP OFF"
    assert not gpib.plant.on


@pytest.mark.parametrize("left", [b"CALC1:DATA?", b"*IDN?", b"SOUR:VOLT?;FREQ?"])
def test_making_safe_works_whatever_another_program_left_unread(gpib, ready, left: bytes) -> None:
    gpib.do(lambda: gpib.twins["hp89410a"].listen(left))
    gpib.connect(hp89410a).make_safe()
    assert not gpib.plant.on


def test_making_safe_works_while_averages_are_being_taken(gpib, ready) -> None:
    ready.start_measurement()
    begun = time.monotonic()
    gpib.connect(hp89410a).make_safe()
    assert not gpib.plant.on
    assert time.monotonic() - begun < 1.0


def test_making_safe_says_so_when_nobody_answers(gpib, analyzer) -> None:
    gpib.plant.faults["gpib.silence"] = 19
    with pytest.raises(NoAnswer):
        gpib.connect(hp89410a, timeout="100 ms").make_safe()


# ------------------------------------------------------------------------------------------------------ the set-up


def test_after_the_set_up_the_settings_read_back(ready) -> None:
    found = ready.settings()
    assert found["mode"] == "VECT"
    assert (found["start"], found["stop"], found["points"], found["averages"]) == (0.0, 1000.0, 401, 4)
    assert (found["input_1_coupling"], found["input_2_coupling"]) == ("DC", "DC")
    assert (found["source_frequency"], found["source_level"], found["source_level_unit"]) == (100.0, 0.5, "VPK")
    assert (found["output"], found["calibration_auto"]) == (True, False)


@pytest.mark.parametrize(
    "wrong", [{"points": 400}, {"span": 0.5}, {"span": 2e7}, {"averages": 0}, {"averages": 100_000}, {"span": math.nan}]
)
def test_a_set_up_that_is_impossible_is_refused_without_sending_anything(gpib, analyzer, wrong) -> None:
    with pytest.raises(SettingRefused):
        analyzer.configure(**{"span": 1000.0, "points": 401, "averages": 4, **wrong})
    assert gpib.pages.sent() == []


def test_an_error_during_the_set_up_is_named(gpib, analyzer) -> None:
    gpib.do(lambda: gpib.twins["hp89410a"].listen(b"NONSENSE;:SOUR:VOLT 9 VPK"))
    gpib.do(lambda: gpib.twins["hp89410a"].listen(b"SOUR:VOLT 9 VPK"))
    with pytest.raises(SettingRefused, match=r"-113.*-200"):
        analyzer.configure(span=1000.0, points=401, averages=4)
    assert analyzer.errors() == []


def test_a_preset_forgets_older_errors(gpib, analyzer) -> None:
    gpib.do(lambda: gpib.twins["hp89410a"].listen(b"NONSENSE"))
    analyzer.preset()
    assert analyzer.errors() == []


@pytest.mark.parametrize(("volts", "wanted"), [(1.0, 10.0), (0.1, -10.0), (0.01, -30.0), (0.001, -30.0), (7.9, 28.0)])
def test_the_range_is_the_smallest_two_decibel_step_that_holds_the_signal(ready, volts, wanted) -> None:
    found = ready.set_range(2, volts)
    assert found == pytest.approx(math.sqrt(0.1 * 10 ** (wanted / 10)))
    assert found >= volts * 0.999999
    assert ready.settings()["input_2_range_dbm"] == pytest.approx(wanted)


@pytest.mark.parametrize(("channel", "volts"), [(3, 1.0), (1, 0.0), (1, -1.0), (1, 8.0), (1, math.nan)])
def test_a_range_that_does_not_exist_is_refused_without_sending_anything(gpib, analyzer, channel, volts) -> None:
    with pytest.raises(SettingRefused):
        analyzer.set_range(channel, volts)
    assert gpib.pages.sent() == []


def test_autorange_finds_ranges_that_hold_the_signals(gpib, ready) -> None:
    ready.set_range(1, 7.0)
    ready.autorange()
    found = ready.settings()
    assert 0.5 <= math.sqrt(0.1 * 10 ** (found["input_1_range_dbm"] / 10)) < 0.8


# --------------------------------------------------------------------------------------------------- measurements


@pytest.mark.parametrize("frequency", [20.0, 100.0, 252.5, 500.0])
def test_the_response_is_the_plants(gpib, ready, frequency: float) -> None:
    ready.set_sine(frequency, 0.5)
    found = ready.measure()
    expected = gpib.plant.response(frequency)
    assert abs(found.at(frequency) / expected - 1) < 2e-3
    assert found.coherence is not None
    assert found.coherence[int(np.argmin(abs(found.frequency - frequency)))] > 0.999
    assert (found.averages, found.overloads) == (4, ())
    assert (found.frequency[0], found.frequency[-1], len(found.frequency)) == (0.0, 1000.0, 401)


def test_all_averages_are_really_waited_for(gpib, ready) -> None:
    ready.start_measurement()
    begun = gpib.now()
    assert ready.finish_measurement().averages == 4
    assert gpib.now() - begun >= 4 * 0.4


def test_a_measurement_that_is_done_already_is_read_without_waiting(gpib, ready) -> None:
    ready.start_measurement()
    gpib.sleep(3.0)
    begun = gpib.now()
    ready.finish_measurement()
    assert gpib.now() - begun < 0.4


def test_a_point_costs_few_messages(gpib, ready) -> None:
    ready.measure()
    before = len(gpib.pages.sent())
    ready.set_sine(120.0, 0.5)
    ready.measure()
    assert len(gpib.pages.sent()) - before <= 9


def test_overloads_during_the_measurement_are_named(gpib, ready) -> None:
    ready.set_range(2, 0.5)
    assert ready.measure().overloads == ("input 2",)
    ready.set_range(2, 2.0)
    assert ready.measure().overloads == ()
    gpib.plant.faults["hp89410a.overload"] = 1
    assert "input 1" in ready.measure().overloads


def test_averages_that_never_end_are_no_answer_with_the_instruments_state(gpib, ready) -> None:
    gpib.do(lambda: gpib.twins["hp89410a"].listen(b"TRIG:SOUR BUS"))
    ready.start_measurement()
    with pytest.raises(NoAnswer, match=r"operation condition \+\d+"):
        ready.finish_measurement(patience=3.0)


def test_the_two_inputs_are_seen_in_one_record(gpib, ready) -> None:
    found = ready.time_traces()
    assert found.interval == pytest.approx(1 / 2560)
    assert found.volts.shape == (2, 1024)
    times = found.start + found.interval * np.arange(1024)
    basis = np.exp(-2j * np.pi * 100.0 * times) * np.hanning(1024)
    one, two = found.volts @ basis
    assert two / one == pytest.approx(gpib.plant.response(100.0), rel=2e-3)
    assert np.max(found.volts[0]) == pytest.approx(0.5, rel=0.01)
    assert abs(ready.measure().at(100.0) / gpib.plant.response(100.0) - 1) < 2e-3


def test_measuring_before_the_set_up_is_refused(analyzer) -> None:
    for attempt in (analyzer.start_measurement, analyzer.time_traces):
        with pytest.raises(SettingRefused, match="configured"):
            attempt()


def test_zeroing_waits_for_its_end(gpib, ready) -> None:
    begun = gpib.now()
    ready.zero()
    assert gpib.now() - begun >= 0.5


# ------------------------------------------------------------------------------------------------ broken exchanges


def test_a_serial_poll_leaves_a_pending_reply_and_works_right_after_a_block(gpib, ready) -> None:
    link = ready._link
    link.write("*OPT?")
    assert link.poll() & 16  # a message is available
    assert gpib.do(gpib.twins["hp89410a"].talk) == b'"AY7"\n'
    ready.measure()
    assert link.poll() & 16 == 0
    assert link.query("*OPT?") == '"AY7"'
    assert errors_of(gpib) == []


def test_a_gateway_that_goes_away_in_mid_block_is_disconnected_at_once(gpib, ready) -> None:
    ready.start_measurement()
    gpib.sleep(3.0)
    link = ready._link
    gpib.plant.faults["gpib.drop"] = True
    begun = time.monotonic()
    with pytest.raises(Disconnected, match="CALC1:DATA"):
        link.query_block("CALC1:DATA?")
    assert time.monotonic() - begun < 1.0
    gpib.connect(hp89410a).make_safe()
    assert not gpib.plant.on


def test_a_truncated_block_is_no_answer_and_the_next_measurement_is_right(gpib) -> None:
    analyzer = gpib.connect(hp89410a, timeout="200 ms")
    analyzer.preset()
    analyzer.configure(span=1000.0, points=401, averages=1)
    gpib.plant.faults["gpib.truncate"] = 1000
    with pytest.raises(NoAnswer, match="the rest of the answer"):
        analyzer.measure()
    assert analyzer.measure().averages == 1


def test_a_late_reply_is_no_answer_and_never_the_next_answer(gpib) -> None:
    analyzer = gpib.connect(hp89410a, timeout="200 ms")
    gpib.plant.faults["gpib.late"] = 19
    with pytest.raises(NoAnswer):
        analyzer.identify()
    del gpib.plant.faults["gpib.late"]
    assert analyzer._link.query("SOUR:FREQ?") == "+1.00000000000000E+006"


def test_a_trace_of_the_wrong_length_is_a_bad_reply(gpib, ready) -> None:
    ready.start_measurement()
    gpib.sleep(3.0)
    gpib.do(lambda: gpib.twins["hp89410a"].listen(b"FORM REAL,32"))
    with pytest.raises(BadReply, match="a block of 3208 bytes"):
        ready.finish_measurement()
