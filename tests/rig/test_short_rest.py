"""A short rest hardly shows the flicker of a zero; the data sheet says how strong it may be."""

from __future__ import annotations

import math

import fast_bench
import pytest

from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import evidence_of
from rig.parts.platter import Platter
from rig.signals.noise import by_sheet

TURNS = {"procedure": "turntable", "revolutions": 2, "rest": "3 s"}
SEEDS = (
    104,
    115,
    135,
    150,
    152,
    155,
    161,
    164,
)  # of a hundred the first eight of eleven that were told of something missing


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_missing_where_nothing_is(seed: int) -> None:
    found = diagnose(evidence_of([fast_bench.measure(TURNS, fast_bench.world(seed))]))
    assert (found.verdict, found.named) == ("adequate", ())


def test_a_part_that_is_louder_than_its_sheet_is_weighed_by_what_its_rest_shows() -> None:
    """White noise of five times the sheet's is told by any rest: the sheet takes none of it for flicker."""
    loud = {"name": "white", "parameters": {"density": 3e-3, "quantity": "acceleration"}}
    (part,) = (one for one in evidence_of([fast_bench.measure(TURNS, fast_bench.world(3, [loud]))]).parts
               if isinstance(one, Platter))  # fmt: skip
    for name, model in zip(part.channels.names, part.data.noise, strict=True):
        size = float(part.channels.sensitivity[part.channels.names.index(name)])
        if name.startswith("unit_a"):
            assert math.sqrt(model.white) / size == pytest.approx(math.hypot(3e-3, 58e-6 * 9.80665), rel=0.15)
            assert model.flicker < 0.2 * model.white


def test_a_sheet_states_white_noise_and_flicker_as_strong_at_the_corner() -> None:
    known = by_sheet(2e-3, 0.1, (1.0, 10.0))
    white, flicker = known["white"], known["flicker"]
    assert white == pytest.approx((2.0 * -6.2146081, 0.2))
    assert flicker[0] - white[0] == pytest.approx(0.5 * 2.302585093)  # the middle of the decade
    assert flicker[1] == pytest.approx((0.2**2 + 2.302585093**2 / 12.0) ** 0.5)
    assert by_sheet(2e-3, 0.1, None).keys() == by_sheet(2e-3, 0.1, (0.0, 10.0)).keys() == {"white"}
