"""Terms written as formulas mean what numpy means, let nothing else in, check units, and repair strangers."""

from __future__ import annotations

import math
import re
import runpy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import fast_bench
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fixtures import channels as cabling
from fixtures.imperfections import SHELF, Array, Imperfection
from fixtures.motion import Motion as TrueMotion
from rig.diagnose import search
from rig.diagnose.diagnose import diagnose
from rig.errors import BadInput
from rig.fit import adequacy
from rig.fit.evidence import Evidence, evidence_of
from rig.formula import DEEPEST, LONGEST, formula_effect, own_term, parse, term_of
from rig.model import EVERYWHERE, Quantity
from rig.shelf import shelf

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "add-an-effect.md"
INSTANTS = np.linspace(0.1, 2.0, 7)
VALUES: Mapping[str, Array] = {
    "u": np.sin(3.0 * INSTANTS), "t": INSTANTS, "theta": 5.0 * INSTANTS, "k": np.asarray(0.7), "b2": np.asarray(-1.3)
}  # fmt: skip
Evaluated = tuple[str, Array]

# the grammar, each text with its value as numpy works it out


def _quietly(operation: Callable[..., Array], *values: Array) -> Array:
    with np.errstate(all="ignore"):
        return operation(*values)


def _leaf() -> st.SearchStrategy[Evaluated]:
    names = st.sampled_from(sorted(VALUES)).map(lambda name: (name, VALUES[name]))
    numbers = st.floats(0.0, 100.0).map(lambda x: (repr(x), np.asarray(x)))
    return names | numbers


_OPERATIONS: Mapping[str, Callable[[Array, Array], Array]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide
}  # fmt: skip


def _grown(inner: st.SearchStrategy[Evaluated]) -> st.SearchStrategy[Evaluated]:
    functions = st.sampled_from(["sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign"])
    exponents = st.sampled_from([("2", 2.0), ("3", 3.0), ("-1", -1.0), ("0.5", 0.5), ("(1/2)", 0.5), ("-6", -6.0)])
    return st.one_of(
        st.tuples(functions, inner).map(lambda p: (f"{p[0]}({p[1][0]})", _quietly(getattr(np, p[0]), p[1][1]))),
        st.tuples(inner, st.sampled_from(sorted(_OPERATIONS)), inner).map(
            lambda p: (f"({p[0][0]}{p[1]}{p[2][0]})", _quietly(_OPERATIONS[p[1]], p[0][1], p[2][1]))
        ),
        st.tuples(inner, exponents).map(
            lambda p: (f"({p[0][0]})**{p[1][0]}", _quietly(np.power, p[0][1], np.asarray(p[1][1])))
        ),
        inner.map(lambda one: (f"-({one[0]})", -one[1])),
    )


@given(st.deferred(lambda: st.recursive(_leaf(), _grown, max_leaves=8)))
def test_a_formula_has_the_value_that_numpy_gives_it(case: Evaluated) -> None:
    text, expected = case
    if len(text) <= LONGEST:
        np.testing.assert_array_equal(parse(text).value(VALUES), expected)


def test_operators_bind_as_in_mathematics() -> None:
    assert float(parse("-2**2").value({})) == -4.0
    assert float(parse("8/4/2 - 3*2").value({})) == -5.0


# what is refused

ATTACKS = [
    "__import__('os')", "().__class__", "9**9**9", "9**9", "k if 1 else 2", "[1]", "f'{u}'", "(k := u)", "k*__x",
    "k*a__b", "u.real", "u[0]", "lambda: 1", "[u for u in u]", "{1: 2}", "'k'", "k*True", "k*None", "1j*k", "k*9e999",
    "k*u//2", "k@u", "k%2", "~k", "not k", "k and u", "k < u", "k*sin", "sin(u, u)", "sin(x=u)", "sin(*u)", "eval(k)",
    "(sin)(u)(k)", "(lambda: 1)()", "k*u)+(u", "k u", "", " ", "k*", "k*u\n*u", "k*u\x00", "µ*u", "k*u#", "k*u;u",
    "k*u**w", "k*u**7", "k*u**-6.5", "k*u**(1/0)", "await k", "yield", "...", "(" * 199 + "u" + ")" * 199,
    "-" * 390 + "u",
    "(" * 5000 + "u" + ")" * 5000, "u" + "+u" * 5000, "9" * 390, "abs(" * 90 + "k" + ")" * 90, "*k", "k,", "k=u", "@k",
]  # fmt: skip


@pytest.mark.parametrize("text", ATTACKS, ids=lambda text: repr(text)[:24])
def test_nothing_but_arithmetic_of_signals_gets_in(text: str) -> None:
    if text == "(" * 199 + "u" + ")" * 199:
        assert parse(text).signals == ("u",), "parentheses alone make nothing deeper"
        return
    with pytest.raises(BadInput, match=r"^formula:\d+ found .+, wanted "):
        parse(text)


@given(st.text(max_size=60) | st.text("ku0123.+-*/() sincoexp_,[]{}'\"\\:=@", max_size=60))
def test_any_text_is_either_read_or_refused(text: str) -> None:
    try:
        found = parse(text)
    except BadInput:
        return
    assert set(found.text) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.+-*/() ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("k * exp(-t)", "formula:9 found s in exp, wanted a pure number or an angle"),
        ("k*(u + t)", "formula:8 found s beside rad/s, wanted a sum of like quantities"),
        ("k*u + 1", "formula:1 found a term in 1, wanted rad/s, the unit of the channel"),
        ("  k*foo(u)", "formula:5 found 'foo(…)', wanted one of the functions"),
        ("k*theta*f", "formula:3 found signals that no place of shaker, turntable, rotation, free, poses has together"),
        ("k*b*u", "formula:3 found 'b', whose unit the formula leaves open"),
        ("u**2", "formula:1 found 'u\\*\\*2' without a coefficient"),
        ("k*exp(-t/tau)", "formula:10 found 'tau', in which the term is not proportional, wanted starts for it"),
        ("k*u + u", "formula:1 found 'k', in which the term is not proportional"),
        ("k*a", "formula:3 found 'a' for gyros"),
    ],
)
def test_a_formula_that_cannot_be_is_refused_where_it_fails(text: str, message: str) -> None:
    with pytest.raises(BadInput, match=message.replace("(…)", r"\(…\)")):
        formula_effect("own", text, on="rate")


@pytest.mark.parametrize(
    ("text", "on", "units", "stated", "started"),
    [
        ("k*u**2", "acceleration", {"k": "s²/m"}, {}, ""),
        ("k*sin(3*theta)", "rate", {"k": "rad/s"}, {}, ""),
        ("k*T*u", "rate", {"k": "1/K"}, {}, ""),
        ("k*V**2", "acceleration", {"k": "m/(s²·V²)"}, {}, ""),
        ("k*sqrt(abs(omega))", "acceleration", {"k": "m/(s^(3/2)·rad^(1/2))"}, {}, ""),
        ("k*exp(-t/tau)", "rate", {"k": "rad/s", "tau": "s"}, {}, "tau"),
        ("k*b*u", "rate", {"k": "1/m", "b": "m"}, {"b": "m"}, "b"),
        ("p*u + q*(u - r*u**3)", "acceleration", {"p": "1", "q": "1", "r": "s⁴/m²"}, {}, "r"),
    ],
)
def test_coefficients_get_the_unit_that_makes_the_term_fit(
    text: str, on: Quantity, units: Mapping[str, str], stated: Mapping[str, str], started: str
) -> None:
    effect = formula_effect("own", text, on=on, units=stated, starts={started: (1.0, 2.0)} if started else {})
    assert dict(zip((p.name for p in effect.parameters), effect.units(on), strict=True)) == units
    starts = {c.name: c.starts for c in effect.coordinates}
    assert starts == {name: (1.0, 2.0) if name == started else (0.0,) for name in units}


def test_a_stated_unit_that_contradicts_the_formula_is_refused() -> None:
    with pytest.raises(BadInput, match="found a term in m·rad/s, wanted rad/s"):
        formula_effect("own", "k*u", on="rate", units={"k": "m"})
    with pytest.raises(BadInput, match="found the unit 'furlong' of k"):
        formula_effect("own", "k*u", on="rate", units={"k": "furlong"})


def test_signals_of_one_place_narrow_where_the_effect_acts() -> None:
    assert formula_effect("own", "k*log(f)*u", on="rate").places == ("shaker",)
    assert formula_effect("own", "k*omega**2", on="rate").places == ("turntable",)
    assert formula_effect("own", "k*theta*u", on="rate").places == ("turntable", "rotation")
    assert formula_effect("own", "k*u", on="rate").places == EVERYWHERE
    assert DEEPEST < LONGEST


# strangers


@dataclass
class _Field(Imperfection):
    """A gyro feels something three times per revolution."""

    name = "field"
    stage = "transducer"
    strength: float = 0.01

    def felt(self, channel: cabling.Channel, felt: Array, motion: TrueMotion) -> Array:
        here = channel.quantity == "rate" and motion.mount.place == "turntable"
        return np.asarray(felt + self.strength * np.sin(3.0 * motion.angle)) if here else felt


@dataclass
class _Rectified(Imperfection):
    """Accelerometers feel the square of the drive's voltage."""

    name = "rectified"
    stage = "transducer"
    strength: float = 0.01

    def felt(self, channel: cabling.Channel, felt: Array, motion: TrueMotion) -> Array:
        return np.asarray(felt + self.strength * motion.drive**2) if channel.quantity == "acceleration" else felt


@pytest.fixture(scope="module", autouse=True)
def strangers() -> Iterator[None]:
    """The world knows two imperfections more while these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        for kind in (_Field, _Rectified):
            patch.setitem(SHELF._kinds, kind.name, kind)
        yield


@pytest.fixture(scope="module")
def turned(strangers: None) -> Evidence:
    run = {"procedure": "turntable", "revolutions": 10, "rest": "30 s"}
    return evidence_of([fast_bench.measure(run, fast_bench.world(7, [{"name": "field"}]))])


@pytest.fixture(scope="module")
def shaken(strangers: None) -> Evidence:
    run = {"procedure": "frequency_sweep", "axis": "x"}
    return evidence_of([fast_bench.measure(run, fast_bench.world(7, [{"name": "rectified"}]))])


def test_the_right_formula_brings_the_error_down_to_the_noise(turned: Evidence) -> None:
    without = turned.fitted()
    assert not adequacy.adequate(without)
    repaired = turned.fitted([term_of(formula_effect("field", "k*sin(3*theta) + c*cos(3*theta)", on="rate"))])
    assert adequacy.adequate(repaired)
    assert repaired.chi2 / repaired.count < 1.03
    u = repaired.u(len(repaired.state.terms) - 1)
    at = repaired.state.terms[-1].at  # the world counts the angle clockwise, the model about the upward axis
    assert abs(at["k"] + 0.01) < 4.0 * u["k"] + 1e-5
    assert abs(at["c"]) < 4.0 * u["c"] + 1e-4


def test_a_wrong_formula_does_not(turned: Evidence) -> None:
    assert not adequacy.adequate(turned.fitted([term_of(formula_effect("field", "k*sin(2*theta)", on="rate"))]))


def test_a_term_with_a_start_is_found_by_the_search(shaken: Evidence) -> None:
    """k·exp(−t/τ) has no slope in τ at zero, so the search tries its starts."""
    effect = formula_effect("creep", "k*exp(-t/tau)", on="acceleration", starts={"tau": (30.0, 300.0)})
    (score,) = search.scores(shaken.fitted(), [term_of(effect)])
    assert score.steps == 2
    assert math.isfinite(score.gain)
    assert effect.units("acceleration") == ("m/s²", "s")


def test_a_formula_without_a_value_somewhere_is_refused(shaken: Evidence) -> None:
    with pytest.raises(BadInput, match=r"found no value of 'k\*u/A' in .* of the record"):
        shaken.fitted([term_of(formula_effect("own", "k*u/A", on="acceleration"))])


# the page on effects of one's own


def _blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_the_file_on_the_page_is_an_effect_that_a_diagnosis_names(shaken: Evidence, tmp_path: Path) -> None:
    (code,) = (block for block in _blocks() if "class " in block)
    (tmp_path / "rectified_drive.py").write_text(code, encoding="utf-8")
    found = diagnose(shaken, shelf=shelf(tmp_path))
    assert found.named == ("rectified_drive",)
    assert found.steps[0].taken.term.at["share"] == pytest.approx(0.01, rel=0.02)
    assert adequacy.adequate(found.final)


def test_the_formula_on_the_page_repairs_the_same_stranger(
    shaken: Evidence, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = tmp_path / "page.py"
    text = "\n".join(block for block in _blocks() if "class " not in block)
    of_a_run = 'evidence = evidence_of([open_run("runs/last")])\n'
    assert of_a_run in text  # here it is the stranger's
    code.write_text(text.replace(of_a_run, ""), encoding="utf-8")
    names = runpy.run_path(str(code), {"evidence": shaken})
    assert "k*V**2" in capsys.readouterr().out
    assert adequacy.adequate(shaken.fitted([names["term"]]))


@pytest.mark.parametrize(
    ("given_start", "value", "unit"),
    [
        ("tau=10 s", 10.0, "s"), ("tau = 10 ms", 0.01, "s"), ("tau=2 min", 120.0, "s"), ("tau=1.5", 1.5, ""),
        ("tau=-3e-2 m/s²", -0.03, "m/s²"), ("tau=0.5 g", 4.903325, "m/s²"), ("tau=45 °", math.pi / 4, "rad"),
        ("tau=2 1/V", 2.0, "1/V"), ("tau=50 mV", 0.05, "V"), ("tau=1 kHz", 1000.0, "Hz"), ("tau=3 %", 0.03, "1"),
    ],
)  # fmt: skip
def test_a_start_is_given_in_any_unit_and_kept_in_si(given_start: str, value: float, unit: str) -> None:
    made = own_term("k*exp(-t/tau)", [given_start])
    assert made.starts == {"tau": (pytest.approx(value),)}
    assert dict(made.units) == ({"tau": unit} if unit else {})


def test_several_starts_of_one_coefficient_are_all_tried() -> None:
    assert own_term("k*exp(-t/tau)", ["tau=10 s", "tau=1 min"]).starts == {"tau": (10.0, 60.0)}


@pytest.mark.parametrize("wrong", ["tau", "tau=", "=3 s", "tau=x", "tau=1e999 s", "tau=3 furlong", "tau=3 s s", "10 s"])
def test_a_start_that_cannot_be_read_is_refused(wrong: str) -> None:
    with pytest.raises(BadInput, match=r"start: found .*, wanted .* such as"):
        own_term("k*exp(-t/tau)", [wrong])


def test_a_start_in_the_wrong_unit_is_refused_by_the_formula() -> None:
    own = own_term("k*exp(-t/tau)", ["tau=10 V"])
    with pytest.raises(BadInput, match=r"found s/V in exp, wanted a pure number"):
        formula_effect("creep", own.text, on="rate", units=own.units, starts=own.starts)


def test_a_formula_that_wants_a_start_or_a_unit_says_how_to_give_it() -> None:
    with pytest.raises(BadInput, match=r"wanted starts for it: --start 'tau=VALUE UNIT'"):
        formula_effect("creep", "k*exp(-t/tau)", on="rate")
    with pytest.raises(BadInput, match=r"wanted its unit: --start '\w=VALUE UNIT'"):
        formula_effect("two", "k*p*u", on="rate", starts={"p": (1.0,), "k": (1.0,)})
