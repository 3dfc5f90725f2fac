"""A channel that feels more than its data sheet's range is said to."""

from __future__ import annotations

import copy
from dataclasses import replace

import fast_bench
import pytest

from rig.bench.benchfile import ChannelFile
from rig.fit.evidence import evidence_of


def test_a_gyro_beyond_its_range_is_said_with_its_part() -> None:
    run = fast_bench.measure({"procedure": "turntable", "all": True}, fast_bench.world(11, []))
    assert not any("beyond its range" in note for note in evidence_of([run]).notes)
    header = copy.deepcopy(dict(run.header))
    header["sensor"]["channels"]["gyro_yaw"] |= {"range": "100 °/s", "part": "CRS03-05"}
    said = [note for note in evidence_of([replace(run, header=header)]).notes if "beyond its range" in note]
    assert len(said) == 1
    assert "gyro_yaw (CRS03-05) felt up to 2" in said[0]
    assert said[0].endswith("beyond its range of 100 °/s")


def test_a_range_in_another_unit_is_refused() -> None:
    body = {"part": "p", "quantity": "rate", "axis": "x", "sensitivity": "1 mV/(°/s)", "bandwidth": "50 Hz"}
    with pytest.raises(ValueError, match="found '2 g', wanted an angular rate"):
        ChannelFile.model_validate({**body, "range": "2 g"})
