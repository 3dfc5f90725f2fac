"""The oscilloscope's driver: its parsers by themselves, then over a real socket through the gateway and the twin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import hp54542a
from drivers.hp54542a import EdgeTrigger, Preamble, Window, clipped, parse_preamble, to_volts
from rig.errors import AcquisitionFailed, BadReply, NoAnswer, SettingRefused, WrongIdentity

RANGES = ((4.0, 0.0), (4.0, 0.0), (4.0, 1.0), (4.0, 0.0))
LINE = "2,1,4,1,1.0E-03,-2.0E-03,0,5.0E-04,1.0E+00,16384"


@pytest.fixture
def scope(gpib):
    return gpib.connect(hp54542a, names=["laser", "x", "y", "z"])


@pytest.fixture
def ready(gpib, scope):
    gpib.do(lambda: gpib.plant.set_source(frequency=10.0, level=0.5, on=True))
    scope.configure(duration=0.5, ranges=RANGES, points=4096)
    return scope


# ------------------------------------------------------------------------------------------------------- parsers


def test_a_preamble_by_hand() -> None:
    found = parse_preamble(LINE)
    assert found == Preamble(2, 4, 1e-3, -2e-3, 0.0, 5e-4, 1.0, 16384.0)
    words = np.array([16384, 16386, 16382, 0], ">i2").tobytes()
    assert to_volts(words, found) == pytest.approx([1.0, 1.001, 0.999, -7.192])
    assert found.start == pytest.approx(-2e-3)


def test_bytes_are_read_as_well() -> None:
    found = parse_preamble("1,1,3,1,1E-3,0,0,0.03125,0,64")
    assert to_volts(bytes([64, 127, 0]), found) == pytest.approx([0.0, 1.96875, -2.0])


@pytest.mark.parametrize(
    "line",
    [
        "",
        "2,1,4",
        LINE + ",1",
        LINE.replace("16384", "x"),
        LINE.replace("16384", "nan"),
        "0" + LINE[1:],
        "4" + LINE[1:],
        "2,0" + LINE[3:],
        "2,3" + LINE[3:],
        LINE.replace(",4,", ",0,"),
        LINE.replace(",4,", ",4.5,"),
        LINE.replace("1.0E-03", "0"),
        LINE.replace("5.0E-04", "-1"),
        ":WAV:PRE " + LINE,
    ],
)
def test_what_is_no_preamble_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        parse_preamble(line)


@given(
    fields=st.tuples(
        st.sampled_from((1, 2)),
        st.sampled_from((1, 2, 4)),
        st.integers(1, 32768),
        st.integers(1, 2048),
        st.floats(1e-12, 1.0),
        st.floats(-10, 10),
        st.floats(-10, 10),
        st.floats(1e-9, 10),
        st.floats(-100, 100),
        st.floats(-1e5, 1e5),
    )
)
def test_every_preamble_survives_its_own_text(fields: tuple[float, ...]) -> None:
    found = parse_preamble(",".join(repr(field) for field in fields))
    assert (found.format, found.points) == (fields[0], fields[2])
    assert (found.x_increment, found.y_reference) == (fields[4], fields[9])


@given(
    text=st.text(max_size=60) | st.lists(st.floats() | st.integers(), max_size=12).map(lambda v: ",".join(map(str, v)))
)
def test_no_text_upsets_the_preamble_parser(text: str) -> None:
    try:
        found = parse_preamble(text)
    except ValueError:
        return
    assert found.points >= 1


@given(codes=st.lists(st.integers(0, 32767), min_size=4, max_size=4))
def test_codes_become_volts_by_the_preambles_equation(codes: list[int]) -> None:
    volts = to_volts(np.array(codes, ">i2").tobytes(), parse_preamble(LINE))
    assert volts == pytest.approx([(code - 16384) * 5e-4 + 1.0 for code in codes])


def test_holes_and_wrong_lengths_are_refused() -> None:
    preamble = parse_preamble(LINE)
    with pytest.raises(ValueError, match="2 of 4 never taken"):
        to_volts(np.array([5, -1, 7, -1], ">i2").tobytes(), preamble)
    with pytest.raises(ValueError, match="8 bytes, found 6"):
        to_volts(bytes(6), preamble)


def test_samples_on_the_first_and_last_step_are_clipped() -> None:
    step = 4.0 / 256
    window = Window(full=4.0, offset=1.0)
    assert clipped(np.array([-1.0, -1.0 + step, 1.0, 3.0 - 2 * step, 3.0 - step]), window) == 2


# ------------------------------------------------------------------------------------------------- on the wire


def test_the_twin_understands_every_message_and_every_question_is_answered(gpib, scope) -> None:
    for message in hp54542a.MESSAGES:
        if "DATA?" in message:
            assert scope._link.query_block(message)
        elif "?" in message:
            assert scope._link.query(message)
        else:
            scope._link.write(message)
        gpib.sleep(2.0)
        assert gpib.do(lambda: list(gpib.twins["hp54542a"].errors)) == [], message


def test_it_says_who_it_is_and_another_is_refused(gpib, scope) -> None:
    assert scope.identify().model == "54542A"
    gpib.plant.faults["hp54542a.identity"] = "HEWLETT-PACKARD,54520A,0,01.00"
    with pytest.raises(WrongIdentity, match="wanted a 54542A"):
        scope.identify()


def test_one_digitize_takes_all_four_channels_at_the_same_instants(gpib, ready) -> None:
    found = ready.capture()
    assert [line for line in gpib.pages.sent() if line.startswith(b":DIG")] == [b":DIG CHAN1,CHAN2,CHAN3,CHAN4;*OPC"]
    assert found.names == ("laser", "x", "y", "z")
    assert found.volts.shape == (4, 4096)
    assert found.start + found.interval * 4096 == pytest.approx(0.5)
    basis = np.exp(-2j * np.pi * 10.0 * found.interval * np.arange(4096))
    one, two = found.volts[:2] @ basis
    assert two / one == pytest.approx(gpib.plant.response(10.0), rel=2e-3)
    assert abs(one) * 2 / 4096 == pytest.approx(0.5, rel=2e-3)
    assert found.volts[2] == pytest.approx(1.25, abs=0.05)


def test_clipped_samples_are_counted(ready) -> None:
    assert ready.capture().clipped == (0, 0, 0, 4096)


def test_it_triggers_on_an_edge(gpib, scope) -> None:
    gpib.do(lambda: gpib.plant.set_source(frequency=10.0, level=0.5, on=True))
    scope.configure(duration=0.5, ranges=RANGES, trigger=EdgeTrigger(1, level=0.25, slope="NEG"))
    first = scope.capture().volts[0]
    assert first[0] == pytest.approx(0.25, abs=0.05)
    assert first[100] < first[0]


def test_settings_are_read_back(ready) -> None:
    found = ready.settings()
    assert (found["duration"], found["points"]) == (0.5, 4096)
    assert (found["channel_3"], found["range_3"], found["offset_3"]) == ("y", 4.0, 1.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"duration": 0.0},
        {"duration": 100.0},
        {"duration": math.nan},
        {"points": 16},
        {"points": 1 << 20},
        {"ranges": RANGES[:3]},
        {"ranges": ((0.0, 0.0), *RANGES[1:])},
        {"ranges": ((1.0, math.inf), *RANGES[1:])},
        {"trigger": EdgeTrigger(5)},
    ],
)
def test_what_is_impossible_is_refused_without_sending_anything(gpib, scope, wrong) -> None:
    with pytest.raises(SettingRefused):
        scope.configure(**{"duration": 0.5, "ranges": RANGES, **wrong})
    assert gpib.pages.sent() == []


def test_a_range_the_instrument_does_not_have_is_refused(scope) -> None:
    with pytest.raises(SettingRefused, match="a range of at least 900 V"):
        scope.configure(duration=0.5, ranges=((900.0, 0.0), *RANGES[1:]))


def test_capturing_before_the_set_up_is_refused(scope) -> None:
    with pytest.raises(SettingRefused, match="a configured record"):
        scope.capture()


def test_a_missing_trigger_ends_in_no_answer_after_a_device_clear_and_the_next_capture_works(gpib, ready) -> None:
    gpib.plant.faults["hp54542a.no_trigger"] = True
    with pytest.raises(NoAnswer, match="a trigger"):
        ready.capture(patience=2.0)
    del gpib.plant.faults["hp54542a.no_trigger"]
    assert ready.capture().volts.shape == (4, 4096)
    assert ready.errors() == []


def test_a_record_with_holes_is_refused(gpib, ready, monkeypatch) -> None:
    twin = gpib.twins["hp54542a"]
    keep = twin._keep_waveforms

    def with_holes(work):
        keep(work)
        for waveform in twin._memory.values():
            waveform.levels[5] = np.nan

    monkeypatch.setattr(twin, "_keep_waveforms", with_holes)
    with pytest.raises(AcquisitionFailed, match="1 of 4096 never taken"):
        ready.capture()


def test_a_channel_with_steps_of_another_size_than_the_others_is_refused(gpib, ready, monkeypatch) -> None:
    twin = gpib.twins["hp54542a"]
    found = twin._preamble

    def with_larger_steps():
        fields = found().split(",")
        if twin.values["WAV:SOUR"] == 2:
            fields[7] = f"{1.03 * float(fields[7]):.6E}"
        return ",".join(fields)

    ready.capture()
    monkeypatch.setattr(twin, "_preamble", with_larger_steps)
    with pytest.raises(BadReply, match=r"CHAN2;PRE.* the same share of the range"):
        ready.capture()


def test_a_reply_with_its_header_still_on_is_a_bad_reply(gpib, ready) -> None:
    gpib.do(lambda: gpib.twins["hp54542a"].listen(b":SYST:HEADER ON"))
    with pytest.raises(BadReply, match="2 numbers"):
        ready.settings()


def test_errors_are_drained_as_numbers(gpib, ready) -> None:
    for message in (b":NONSENSE", b":CHAN1:RANGE 900"):
        gpib.do(lambda message=message: gpib.twins["hp54542a"].listen(message))
    assert ready.errors() == ["-113", "-222"]
    assert ready.errors() == []


def test_both_instruments_behind_one_gateway_take_turns(gpib, ready) -> None:
    from drivers import hp89410a

    analyzer = gpib.connect(hp89410a)
    for _ in range(5):
        assert (ready.identify().model, analyzer.identify().model) == ("54542A", "89410A")
    assert gpib.adapter.connections == 1
