"""What is there does not change when twice the band is compared; what does is marked, and never certain."""

from __future__ import annotations

from dataclasses import replace

import blind_imports
import blind_laws
import imported_worlds as worlds
import numpy as np
import pytest
from blind_imports import Record
from imported_worlds import Array, Unit
from scipy.signal import butter, lfilter

from rig.cli.repair import candidate_text
from rig.diagnose import bands, instruments
from rig.diagnose.conclusion import concluded
from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import Evidence
from rig.foreign.tables import Foreign
from rig.model import Term
from rig.parts.reading import imported
from rig.shelf import shelf

SEED = 678834756
HUNDRED = np.radians(100.0)


def evidence(log: Foreign) -> Evidence:
    """What a model is compared with, and how to compare twice the band."""
    made = worlds.evidence(log)
    return replace(made, twice=lambda: imported.twice([log], made.parts))


def lagging(rate: Array) -> Array:
    """Two poles, which a pure delay is only at the lowest frequencies."""
    return np.asarray(lfilter(*butter(2, 4.0, fs=100.0), rate))


def with_a_delay(log: Foreign) -> tuple[Evidence, frozenset[bands.Known]]:
    made = evidence(log)
    term = Term(shelf()["delay"], "rate", {"time": 0.02})
    return made, bands.dependent(made, made.fitted([term]))


def test_twice_the_band_is_what_is_compared_further() -> None:
    made = evidence(worlds.rotation(Unit(), 3, seconds=20.0, channels="r", band=2.0))
    further = made.further()
    assert further is not None
    assert [part.bands for part in further.parts] == [(4.0, 4.0)]
    assert sum(part.rows for part in further.parts) > 1.8 * sum(part.rows for part in made.parts)


def test_a_delay_that_is_there_does_not_depend_on_the_band() -> None:
    log = worlds.rotation(Unit(rate_delay=0.02), 3, seconds=30.0, channels="r", band=1.5, jitter=1e-4)
    _, found = with_a_delay(log)
    assert not found


def test_a_delay_that_is_two_poles_depends_on_the_band_and_is_said_to() -> None:
    log = worlds.rotation(Unit(), 3, seconds=30.0, channels="r", band=1.5, jitter=1e-4)
    _, found = with_a_delay(worlds.changed(log, "gyro_z", lagging))
    assert found == {("delay", "rate", ())}


def test_what_depends_on_the_band_is_marked_and_no_likelier_than_evens() -> None:
    log = worlds.rotation(Unit(rate_delay=0.02), 3, seconds=30.0, channels="r", band=1.5, jitter=1e-4)
    made = evidence(log)
    known = {name: one for name, one in shelf().items() if name == "delay"}
    diagnosis = diagnose(made, shelf=known)
    (one,) = concluded(made, diagnosis, known).taken
    assert not one.depends_on_band
    other = evidence(worlds.changed(log, "gyro_z", lagging))
    (marked,) = concluded(replace(made, twice=other.twice), diagnosis, known).taken
    assert marked.depends_on_band
    assert marked.probability <= 0.5 < one.probability
    assert marked.as_json()["depends_on_band"] is True
    assert any("DEPENDS ON THE BAND" in line for line in candidate_text(marked, nearest=False))


def test_a_gain_that_only_makes_up_for_what_is_missing_is_no_wrong_unit() -> None:
    log = worlds.rotation(Unit(rate_zero=(0.0, 0.0, 0.0)), 4, seconds=30.0, channels="r")
    bent = worlds.evidence(worlds.changed(log, "gyro_z", lambda rate: rate * (1.0 + 0.25 * (rate / HUNDRED) ** 2)))
    made = diagnose(bent)
    assert instruments.implausible(made.base)
    assert made.named[0] == "cubic"
    assert made.final.state.gain["gyro_z"] == pytest.approx(0.0, abs=0.02)
    assert not made.misplaced


def test_what_other_stretches_make_of_a_true_effect_is_no_dependence_on_the_band() -> None:
    """Twice the band has another grid, other stretches and weights: this estimate moves by 1.2 of its uncertainty."""
    law = blind_laws.law_of("asymmetry")
    made = blind_imports.evidence(Record("rotation", SEED, law, {"size": 0.0088, "on": "rate"}).made())
    assert not bands.dependent(made, made.fitted([Term(shelf()["asymmetry"], "rate", {"ratio": 0.0088})]))
