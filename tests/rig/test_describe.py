"""Effects that are on no shelf are described by what the data show of them, with a formula that repairs the model."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace

import fast_bench
import numpy as np
import pytest

from fixtures import channels as cabling
from fixtures.imperfections import SHELF, Array, Imperfection
from fixtures.motion import Motion as TrueMotion
from rig.archive.records import Recorded
from rig.cli.repair import add
from rig.diagnose.conclusion import trying
from rig.diagnose.describe import Description, describe
from rig.fit import adequacy
from rig.fit.evidence import Evidence, evidence_of
from rig.formula import formula_effect, meets, own_term, term_of
from rig.model import BOTH
from rig.parts.formulas import ANYWHERE, OF_PLATTER, OF_SHAKER
from rig.parts.sweep import Sweep
from rig.repair.repair import Repaired, added, bench_of, channels_named, new
from rig.shelf import shelf

SWEEP = {"procedure": "frequency_sweep", "axis": "x"}
TURNS = {"procedure": "turntable", "revolutions": 6, "rest": "10 s", "all": True}


@dataclass
class _Bent(Imperfection):
    """Accelerometers, or one of them, feel the square of the drive's voltage."""

    name = "bent"
    stage = "transducer"
    alone: float = 0.0

    def felt(self, channel: cabling.Channel, felt: Array, motion: TrueMotion) -> Array:
        here = channel.name == "unit_b_x" if self.alone else channel.quantity == "acceleration"
        return np.asarray(felt + 0.01 * motion.drive**2) if here else felt


@dataclass
class _Poles(Imperfection):
    """Gyros feel five poles around the platter, the cube of one, and the root of its rate."""

    name = "poles"
    stage = "transducer"
    wave: float = 0.0
    root: float = 0.0
    cube: float = 0.0

    def felt(self, channel: cabling.Channel, felt: Array, motion: TrueMotion) -> Array:
        if channel.quantity != "rate" or motion.mount.place != "turntable":
            return felt
        root = np.sqrt(np.abs(motion.rate[1]))
        waves = self.wave * np.sin(5.0 * motion.angle + 0.7) + self.cube * np.cos(motion.angle - 0.4) ** 3
        return np.asarray(felt + waves + self.root * root)


@pytest.fixture(scope="module", autouse=True)
def strangers() -> Iterator[None]:
    """The world knows two imperfections more while these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        for kind in (_Bent, _Poles):
            patch.setitem(SHELF._kinds, kind.name, kind)
        yield


def _measured(document: dict[str, object], hidden: list[dict[str, object]]) -> Recorded:
    return fast_bench.measure(document, fast_bench.world(11, hidden))


def _described(document: dict[str, object], hidden: list[dict[str, object]]) -> tuple[Evidence, Description]:
    evidence = evidence_of([_measured(document, hidden)])
    return evidence, describe(evidence, evidence.fitted())


def _added(records: Recorded, line: str) -> Repaired:
    """What the printed command does, read as the command line reads it."""
    program, name, *words = shlex.split(line)
    assert (program, name) == ("rig", "add")
    asked = add.make_context("add", words).params
    bench = bench_of([records], shelf())
    quantity, channels = channels_named(bench, asked["on"])
    own = own_term(asked["formula"], asked["start"], channels)
    return added(bench, new(bench, "datasheet"), asked["effect"], quantity, own)


def _repairs(evidence: Evidence, found: Description) -> bool:
    assert found.on is not None
    effect = formula_effect("tried", found.formula, on=found.on, starts=found.starts, channels=found.only)
    return adequacy.adequate(evidence.fitted([term_of(effect)]))


def test_the_printed_command_does_what_is_said_of_it() -> None:
    records = _measured({**SWEEP, "points": 8}, [{"name": "bent", "parameters": {"alone": 1.0}}])
    evidence = evidence_of([records])
    found = describe(evidence, evidence.fitted())
    assert found.repairs
    line = trying(evidence.runs, found, set())
    assert "--on unit_b_x" in line
    made = _added(records, line)
    assert found.before is not None
    assert found.after is not None
    where = found.before.worst.where
    assert f"{made.before.error:.4g} to {made.after.error:.4g} times" in " ".join(found.words)
    assert f"in {where} from {made.before.worst:.3g} to {made.at(where).ratio:.3g}." in " ".join(found.words)
    assert made.after.heldout == pytest.approx(found.after.heldout, rel=1e-3)
    assert found.held is not None
    assert f"{found.held[1]:.3g}" in " ".join(found.words)


def test_what_explains_nothing_of_what_is_held_out_is_not_offered() -> None:
    """A square of the drive in the rows that are fitted, and none in those held out."""
    document = {**SWEEP, "points": 8}
    bent, clean = (evidence_of([_measured(document, hidden)]) for hidden in ([{"name": "bent"}], []))
    part, other = (next(one for one in of.parts if isinstance(one, Sweep)) for of in (bent, clean))
    held = part.held_out.reshape(len(part.channels.names), len(part.data.index), -1)[:, :, :1]
    observed = np.where(held, other.data.observed, part.data.observed)
    own = Sweep(replace(part.data, observed=observed))
    mixed = replace(bent, parts=tuple(own if one is part else one for one in bent.parts))
    found = describe(mixed, mixed.fitted())
    assert found.held is not None
    assert found.held[1] > found.held[0]
    assert (found.formula, found.term) == ("", None)
    assert any("none is offered" in sentence for sentence in found.words)


def test_the_cube_of_a_wave_is_repaired_by_waves_of_two_orders() -> None:
    evidence, found = _described(TURNS, [{"name": "poles", "parameters": {"cube": 0.02}}])
    assert set(found.orders) == {1, 3}
    assert sorted(found.formula.count(f"({order}*theta)") for order in (1, 3)) == [2, 2]
    assert found.repairs
    assert _repairs(evidence, found)


def test_a_square_of_the_drive_is_described_by_lines_powers_and_parity() -> None:
    evidence, found = _described(SWEEP, [{"name": "bent"}])
    assert found.domains[0] == "2f"
    assert "unit_a_x" in found.channels
    assert not any("gyro" in channel for channel in found.channels)
    assert found.exponents["frequency"] == pytest.approx(-4.0, abs=0.1)  # a = −ω²kV
    assert found.exponents["level"] == pytest.approx(2.0, abs=0.05)
    assert found.parity == "even"
    assert (found.formula, found.on) == ("k*V**2", "acceleration")
    assert found.explained > 0.95
    assert _repairs(evidence, found)
    assert any("power 2.0" in sentence for sentence in found.words)


def test_what_one_channel_shows_alone_is_described_for_that_channel() -> None:
    evidence, found = _described(SWEEP, [{"name": "bent", "parameters": {"alone": 1.0}}])
    assert found.channels == ("unit_b_x",)
    assert (found.formula, found.only) == ("k*V**2", ("unit_b_x",))
    assert _repairs(evidence, found)


def test_a_wave_of_the_angle_is_described_by_its_order_and_repaired_by_sine_and_cosine() -> None:
    evidence, found = _described(TURNS, [{"name": "poles", "parameters": {"wave": 0.02}}])
    assert found.orders == (5,)
    assert found.formula == "k1*cos(5*theta) + k2*sin(5*theta)"
    assert all(sentence.endswith(".") for sentence in found.words)
    assert _repairs(evidence, found)
    assert found.term is not None
    assert np.hypot(found.term.at["k1"], found.term.at["k2"]) == pytest.approx(0.02, rel=0.02)


def test_a_root_of_the_rate_is_described_by_its_power_and_parity() -> None:
    evidence, found = _described(TURNS, [{"name": "poles", "parameters": {"root": 0.05}}])
    assert found.exponents["rate"] == pytest.approx(0.5, abs=0.1)
    assert found.parity == "even"
    assert found.orders == ()
    assert "sqrt(abs(omega))" in found.formula
    assert _repairs(evidence, found)


def test_where_nothing_is_missing_nothing_is_described() -> None:
    _, found = _described(SWEEP, [])
    assert found.domains == ()
    assert found.words[0] == "Nothing stands out of the noise."
    assert found.formula == ""


def test_every_shape_of_the_library_and_every_pair_that_can_meet_is_a_formula() -> None:
    shapes = list(dict.fromkeys([*ANYWHERE, *OF_SHAKER, *OF_PLATTER]))
    waves = [one for one in shapes if "theta" in one][:4]
    few = [one for one in shapes if "theta" not in one] + waves
    pairs = [pair for pair in itertools.combinations(few, 2) if not all("{tau}" in one for one in pair)]
    for on in BOTH:
        for one in [(shape,) for shape in shapes] + pairs:
            text = " + ".join(f"k{n}*{shape.format(tau='tau')}" for n, shape in enumerate(one))
            starts = {"tau": (20.0,)} if "tau" in text else {}
            if meets(text):
                assert formula_effect("tried", text, on=on, starts=starts).places


def test_what_only_the_platter_knows_and_what_only_the_shaker_knows_do_not_meet() -> None:
    assert not meets("k1*omega + k2*f")
    assert not meets("k1*sin(3*theta) + k2*V")
    assert meets("k1*omega + k2*sin(3*theta)")
    assert meets("k1*u**2 + k2*f")


def test_a_line_that_is_no_motion_s_is_described_over_sweep_and_turntable_together() -> None:
    line = {"name": "spur", "parameters": {"quantity": "rate", "amplitude": 0.007, "frequency": 6.847}}
    world = fast_bench.world(4242, [line])
    runs = [fast_bench.measure(one, world) for one in ({**SWEEP, "points": 6}, TURNS)]
    evidence = evidence_of(runs)
    found = describe(evidence, evidence.fitted())
    assert found.channels[0].startswith(("gyro", "backup"))
    assert found.formula == "" or meets(found.formula)
