"""A reference whose gain is known to 5 % makes sensitivities that are known to 5 %, however many rows there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imported_sweeps import made as sweep
from imported_worlds import Sensor, Unit, evidence, motion, response, response_table, rotation

from rig.fit import adequacy
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.foreign.tables import Foreign
from rig.parts.reference_gain import shared

U = 0.05


def stated(foreign: Foreign, columns: tuple[str, ...], u: float = U) -> Foreign:
    """The same data of an owner who says how well the gain of these references is known."""
    made = foreign.manifest
    said = [one.model_copy(update={"gain_uncertainty": u}) if one.column in columns else one for one in made.columns]
    return replace(foreign, manifest=made.model_copy(update={"columns": said}))


def swung() -> Foreign:
    return rotation(Unit(rate_gain=(1.0, 1.0, 1.01)), channels="r", seconds=60.0)


def shaken() -> Foreign:
    return sweep()


def tabled() -> Foreign:
    return response([response_table(Sensor(gain=1.01).phasor)])


def thrown() -> Foreign:
    return motion(Unit(), seconds=20.0, channels="f")


def relative(found: Fit, channel: str) -> float:
    """Standard uncertainty of a channel's sensitivity, relative."""
    place = found.layout.gains[channel]
    return float(np.sqrt(found.covariance[place, place])) / (1.0 + found.state.gain[channel])


KINDS = {
    "rotation": (swung, ("angle",), "gyro_z"),
    "sweep": (shaken, ("base",), "board"),
    "response": (tabled, ("excitation",), "acc"),
    "response, of the ratio": (tabled, ("magnitude",), "acc"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensitivity_is_as_uncertain_as_its_reference_and_noise_and_verdict_stay(kind: str) -> None:
    make, columns, channel = KINDS[kind]
    data = make()
    sure, doubtful = evidence(data).fitted(), evidence(stated(data, columns)).fitted()
    assert relative(sure, channel) < 0.2 * U
    assert relative(doubtful, channel) == pytest.approx(U, rel=0.03)
    assert doubtful.state.gain[channel] == pytest.approx(sure.state.gain[channel], abs=0.02 * U)
    assert doubtful.chi2 == pytest.approx(sure.chi2, rel=1e-3)
    assert adequacy.adequate(doubtful) == adequacy.adequate(sure)


def test_positions_doubtful_by_their_scale_leave_gravity_to_calibrate_by() -> None:
    data = thrown()
    sure, doubtful = evidence(data), evidence(stated(data, ("px", "py", "pz")))
    gain = next(term for term in doubtful.nuisances if term.effect.name == "gain of the positions")
    assert gain.prior == {"relative": U}
    before, after = sure.fitted(), doubtful.fitted()
    for name in ("acc_x", "acc_y", "acc_z"):
        assert relative(before, name) < relative(after, name) < U


def test_a_reference_of_two_runs_is_one_and_another_stays_another() -> None:
    data = swung()
    one, two = (replace(data, run=run) for run in ("one", "two"))

    def together(*all_: Foreign) -> Evidence:
        made = evidence(*all_)
        return replace(made, nuisances=tuple(shared(made.nuisances)))

    same = together(stated(one, ("angle",)), stated(two, ("angle",)))
    assert sum(term.effect.name.startswith("gain of") for term in same.nuisances) == 1
    assert relative(same.fitted(), "gyro_z") == pytest.approx(U, rel=0.03)
    other = together(stated(one, ("angle",)), stated(two, ("angle",), 0.01))
    assert relative(other.fitted(), "gyro_z") == pytest.approx(0.01, rel=0.1)
