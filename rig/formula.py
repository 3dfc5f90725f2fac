"""An effect without Python: a term written as a formula of named signals, such as `k * omega**2 * sin(theta)`.

The formula's value, in the SI unit of the channel, is added to what each channel feels. Names that are no signals are
its coefficients, which a fit determines. Nothing is run that the text says: it is read as arithmetic of numbers, names,
`+ - * / **`, parentheses and the functions sin cos tan exp log sqrt abs sign, and anything else is refused. Units are
checked: sums add like to like, sin, cos, tan and exp take a pure number (radians are one), and every coefficient gets
the unit that makes the term fit its channel. log takes the number that its argument has in SI units.
"""

from __future__ import annotations

import ast
import itertools
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType
from typing import ClassVar, cast

import numpy as np

from rig import units as spelled
from rig.dimensions import Dimension, dimension_of, solve, unknown
from rig.errors import BadInput
from rig.model import (
    EVERYWHERE,
    SI,
    Added,
    Array,
    Channels,
    Coordinate,
    Effect,
    Expression,
    Inverse,
    Lost,
    Motion,
    Parameter,
    Quantity,
    Term,
    Values,
)
from rig.motion import Periods, Stretches

LONGEST = 400  # characters
DEEPEST = 40  # operations within one another
HIGHEST_POWER = 6.0
MOST = 8  # coefficients
LARGEST = 1e30  # number in the text
LINEAR_STEP = 1e-6  # a term that is straight may take any; this one stays far from rounding
CURVED_STEP = 1e-3  # of a start

SIGNALS: Mapping[str, str] = MappingProxyType(
    {
        "u": "SI", "a": "m/s²", "omega": "rad/s", "alpha": "rad/s²", "theta": "rad", "g": "m/s²", "t": "s", "T": "°C",
        "Vs": "V", "f": "Hz", "A": "m/s²", "V": "V", "x": "m/s²", "y": "m/s²", "z": "m/s²", "wx": "rad/s",
        "wy": "rad/s", "wz": "rad/s",
    }
)  # fmt: skip
ONLY_AT: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"omega": ("turntable",), "alpha": ("turntable",), "theta": ("turntable", "rotation"), "f": ("shaker",),
     "A": ("shaker",), "V": ("shaker",)}
)  # fmt: skip
LOGGED: Mapping[str, str] = MappingProxyType(
    {"T": "temperature", "Vs": "supply", "V": "source"}
)  # as effects need them
FUNCTIONS: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {"sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "abs": np.abs,
     "sign": np.sign}
)  # fmt: skip
KINKED = frozenset({"abs", "sign"})
_ANGLES = frozenset({"sin", "cos", "tan", "exp"})
_BINARY: Mapping[type[ast.operator], Callable[[Array, Array], Array]] = MappingProxyType(
    {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power}
)
_SYMBOLS: Mapping[type[ast.operator], str] = MappingProxyType(
    {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
)
CARRIED = frozenset({"u", "a", "x", "y", "z", "wx", "wy", "wz", "t", "T", "Vs"})  # what goes along with a robot
SAME: Mapping[str, str] = MappingProxyType({"a": "u"})
_WANTED = "numbers, names, + - * / **, parentheses and the functions " + " ".join(FUNCTIONS)


@dataclass(frozen=True)
class OwnTerm:
    """A term of one's own as a person gives it.

    `text` of the formula; `starts` of coefficients, SI; `units` (of m, s, rad, K, V) of coefficients as far as stated;
    `channels` that alone feel it, () for all of a quantity.
    """

    text: str
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    channels: tuple[str, ...] = ()


def own_term(text: str, starts: Sequence[str] = (), channels: Sequence[str] = ()) -> OwnTerm:
    """A term whose starts are given as `tau=10 s`, several for one coefficient if wanted. Raises BadInput."""
    values: dict[str, tuple[float, ...]] = {}
    units: dict[str, str] = {}
    for given in starts:
        name, value, unit = _start(given)
        values[name] = (*values.get(name, ()), value)
        units |= {name: unit} if unit else {}
    return OwnTerm(text, values, units, tuple(channels))


def _start(text: str) -> tuple[str, float, str]:
    """Name, SI value and SI unit of `tau=10 ms`; '' for a unit that is not stated."""
    name, _, quantity = (part.strip() for part in text.partition("="))
    found = re.fullmatch(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(.*)", quantity)
    number = float(found[1]) if found else math.nan
    if not name or found is None or not math.isfinite(number):
        raise BadInput(f"start: found '{text}', wanted a coefficient, its value and its unit such as 'tau=10 s'")
    if not found[2] or dimension_of(found[2]) is not None:
        return name, number, found[2]
    for kind in spelled.KINDS.values():
        if found[2] in kind.units and dimension_of(kind.si.symbol or "1") is not None:
            return name, spelled.parse(quantity, kind.name), kind.si.symbol or "1"
    raise BadInput(f"start: found the unit '{found[2]}' of {name}, wanted one such as 's', 'ms', 'm/s²' or '1/V'")


@dataclass(frozen=True)
class Formula:
    """A formula that was read: its text, its tree, and the names of signals and coefficients in their order."""

    text: str
    tree: ast.expr
    signals: tuple[str, ...]
    coefficients: tuple[str, ...]

    def value(self, values: Mapping[str, Array]) -> Array:
        """Its value where signals and coefficients have these values, which broadcast; not finite where it has none."""
        with np.errstate(all="ignore"):
            return _value(self.tree, values)

    @property
    def kinked(self) -> bool:
        """Whether it is not smooth."""
        return any(isinstance(one, ast.Name) and one.id in KINKED for one in ast.walk(self.tree))


def parse(text: str) -> Formula:
    """Read a formula. Raises BadInput with the column, counted from one, of what it may not hold."""
    if len(text) > LONGEST:
        raise _wrong(LONGEST + 1, f"{len(text)} characters", f"at most {LONGEST}")
    strange = re.search(r"[^ -~]|#", text)
    if strange:
        raise _wrong(strange.start() + 1, repr(strange[0]), _WANTED)
    tree = _tree(text)
    _allowed(tree, 1)
    names = list(dict.fromkeys(one.id for one in _names(tree)))
    signals = tuple(name for name in names if name in SIGNALS)
    return Formula(text, tree, signals, tuple(name for name in names if name not in SIGNALS))


def _tree(text: str) -> ast.expr:
    """The tree of one expression; columns of its nodes count from one."""
    blank = len(text) - len(text.lstrip())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # "1 is not callable": it is refused later
            ast.parse(text.strip(), mode="eval")
            return ast.parse(f"({text})", mode="eval").body
    except SyntaxError as error:
        column = blank + max(1, min(error.offset or 1, len(text.strip()) + 1))
        raise _wrong(column, _near(text, column), _WANTED) from error
    except (ValueError, RecursionError, MemoryError) as error:
        raise _wrong(1, "something that cannot be read", _WANTED) from error


def formula_effect(
    name: str,
    text: str,
    *,
    on: Quantity,
    places: tuple[str, ...] = EVERYWHERE,
    units: Mapping[str, str] = MappingProxyType({}),
    starts: Mapping[str, tuple[float, ...]] = MappingProxyType({}),
    channels: tuple[str, ...] = (),
) -> Effect:
    """An effect that adds a formula's value to what the channels of one quantity feel.

    `units` states units of coefficients that the formula leaves open. Coefficients in which the formula is linear start
    at zero; the others need `starts`, at which fits begin. Signals that exist at one place only narrow `places`. With
    `channels` only those feel it, instead of all of the quantity.
    Raises BadInput for a text that is no formula, and for dimensions, places or starts that do not fit.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise BadInput(f"formula: found the name '{name}', wanted letters, digits and underscores")
    formula = parse(text)
    if not formula.coefficients:
        raise _wrong(1, f"'{text.strip()}' without a coefficient", "a name that is no signal, such as k")
    if len(formula.coefficients) > MOST:
        raise _wrong(1, f"{len(formula.coefficients)} coefficients", f"at most {MOST}")
    stray = [one for one in (*units, *starts) if one not in formula.coefficients]
    if stray:
        raise BadInput(
            f"formula: found a unit or a start for '{stray[0]}', wanted one of {_list(formula.coefficients)}"
        )
    found = _units(formula, on, units)
    members = {
        "title": f"formula {text.strip()}",
        "equation": f"u + {text.strip()}",
        "quantities": (on,),
        "places": _narrowed(formula, places),
        "coordinates": _coordinates(formula, starts),
        "parameters": tuple(Parameter(c, found[c], _ANYTHING, _ANYTHING) for c in formula.coefficients),
        "kinked": formula.kinked,
        "needs": tuple(LOGGED[name] for name in formula.signals if name in LOGGED),
        "name": name,
        "formula": formula,
        "only": channels,
        "__doc__": f"What is felt grows by {text.strip()}.",
    }
    return cast(Effect, type("Formula", (FormulaEffect,), members)())


_UNIT = "its unit: --start '{name}=VALUE UNIT', in a model file under units"
_START = "starts for it: --start '{name}=VALUE UNIT', in a model file under values"
_ANYTHING = (-math.inf, math.inf)


NODES = ((-math.sqrt(0.6), 5.0 / 18.0), (0.0, 8.0 / 18.0), (math.sqrt(0.6), 5.0 / 18.0))  # of a window, and weights


class FormulaEffect(Effect):
    """An effect given by a formula; made by `formula_effect`."""

    stage = "transducer"
    missing = "what is left over has the shape of the formula"
    separate_by = "a measurement in which the signals of the formula vary apart from each other"
    source = "a formula of one's own"
    formula: ClassVar[Formula]
    only: ClassVar[tuple[str, ...]] = ()

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        """What is felt and the formula's value, (c, *G). Raises BadInput where the formula has no value at a start."""
        more = self._mean(motion, channels, at)
        started = all(at[c.name] in c.starts for c in self.coordinates[1:])
        if started and not np.isfinite(more).all():
            share = 1.0 - float(np.isfinite(more).mean())
            raise BadInput(
                f"formula: found no value of '{self.formula.text}' in {share:.3g} of the record, "
                "wanted a formula without a division by zero or a root or logarithm of negative numbers"
            )
        if self.only:
            theirs = np.array([name in self.only for name in channels.names])
            more = more * theirs.reshape(-1, *(1,) * (felt.ndim - 1))
        return np.asarray(felt + np.broadcast_to(more, felt.shape))

    def _mean(self, motion: Motion, channels: Channels, at: Values) -> Array:
        """Its value; of an angle the mean over each window, by Gauss and Legendre: rates and forces are means already,
        but an angle is that at the middle, and five waves a turn lose 2 % in a window of 32 ms.
        """
        if "theta" not in self.formula.signals or not isinstance(motion.grid, Stretches):
            return self._value(motion, channels, at)
        half = 0.5 * motion.grid.interval * _signal("omega", motion, channels)
        each = (w * self._value(replace(motion, angle=motion.angle + x * half), channels, at) for x, w in NODES)
        return np.asarray(sum(each))

    def _value(self, motion: Motion, channels: Channels, at: Values) -> Array:
        values = {name: _signal(name, motion, channels) for name in self.formula.signals}
        values |= {name: np.asarray(at[name], np.float64) for name in self.formula.coefficients}
        return self.formula.value(values)

    def inverse(self, at: Values) -> Inverse:
        """Its value is taken off where a robot knows all its signals."""
        unknown = [name for name in self.formula.signals if name not in CARRIED]
        if unknown:
            return Lost(f"a robot does not know {_list(unknown)}, which only the bench has")
        if self.only:
            return Lost("it acts on some channels only")
        return Added(_expression(self.formula.tree, at))


def _expression(node: ast.expr, at: Values) -> Expression:
    """The formula with numbers in place of its coefficients."""
    match node:
        case ast.Name(id=name):
            return SAME.get(name, name) if name in SIGNALS else float(at[name])
        case ast.UnaryOp(operand=inner):
            return ("neg", _expression(inner, at))
        case ast.BinOp(left=left, op=operation, right=right):
            return (_SYMBOLS[type(operation)], _expression(left, at), _expression(right, at))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            return (name, _expression(argument, at))
    return float(cast(float, cast(ast.Constant, node).value))


def term_of(effect: Effect) -> Term:
    """A formula's effect as a term at its first starts, to be fitted."""
    return Term(effect, effect.quantities[0], {c.name: c.starts[0] for c in effect.coordinates})


def _signal(name: str, motion: Motion, channels: Channels) -> Array:
    """One signal in a shape that broadcasts to (c, *G)."""
    own = {"x": 0, "y": 1, "z": 2, "wx": 0, "wy": 1, "wz": 2}
    if name in ("u", "a"):
        tall = channels.rates.reshape(-1, *(1,) * (motion.rate.ndim - 1))
        return np.where(tall, motion.rate[channels.axis], motion.force[channels.axis])
    if name in own:
        return np.asarray((motion.rate if name.startswith("w") else motion.force)[own[name]])
    if name in ("omega", "alpha"):
        return np.asarray(np.sum(motion.up * (motion.rate if name == "omega" else motion.turning), axis=0))
    if name == "g":
        return np.asarray(motion.gravity)
    if name == "V":
        return motion.drive_waveform()
    return _of_records(motion, _conditions(name, motion))


def _conditions(name: str, motion: Motion) -> Array:
    """A signal with one value for each record (p,) or instant (n,)."""
    match name:
        case "theta":
            return np.nan_to_num(motion.angle)  # before the index has passed the angle is unknown
        case "t":
            return motion.elapsed
        case "T":
            return motion.temperature
        case "Vs":
            return motion.supply
        case "A":
            return np.abs(motion.along[:, 1])
    grid = motion.grid
    return grid.frequency if isinstance(grid, Periods) else np.asarray(math.nan)


def _of_records(motion: Motion, values: Array) -> Array:
    return values[:, None] if isinstance(motion.grid, Periods) else values


def _value(node: ast.expr, values: Mapping[str, Array]) -> Array:
    match node:
        case ast.Constant(value=number):
            return np.asarray(float(cast(float, number)))
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(operand=inner):
            return np.asarray(-_value(inner, values))
        case ast.BinOp(left=left, op=operation, right=right):
            return np.asarray(_BINARY[type(operation)](_value(left, values), _value(right, values)))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            return np.asarray(FUNCTIONS[name](_value(argument, values)))
    raise TypeError(f"found {type(node).__name__}, wanted what was allowed")


def _allowed(node: ast.expr, depth: int) -> None:
    """Raises BadInput for anything but arithmetic."""
    if depth > DEEPEST:
        raise _wrong(_column(node), f"more than {DEEPEST} operations within one another", "fewer")
    match node:
        case ast.Constant():
            _allowed_number(node)
        case ast.Name(id=name):
            _allowed_name(node, name)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            _allowed(inner, depth + 1)
        case ast.BinOp(left=left, op=operation, right=right) if type(operation) in _BINARY:
            _allowed(left, depth + 1)
            _allowed(right, depth + 1)
            if isinstance(operation, ast.Pow):
                _exponent(right)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            _allowed(argument, depth + 1)
        case ast.Call(func=ast.Name(id=name)):
            wanted = "one argument" if name in FUNCTIONS else f"one of the functions {' '.join(FUNCTIONS)}"
            raise _wrong(_column(node), f"'{name}(…)'", wanted)
        case _:
            raise _wrong(_column(node), f"'{ast.unparse(node)[:40]}'", _WANTED)


def _allowed_number(node: ast.Constant) -> None:
    number = node.value
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not abs(number) <= LARGEST:
        raise _wrong(_column(node), f"'{ast.unparse(node)[:40]}'", f"a number up to {LARGEST:g}")


def _allowed_name(node: ast.Name, name: str) -> None:
    if name in FUNCTIONS:
        raise _wrong(_column(node), f"'{name}' without an argument", f"{name}(…)")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or "__" in name:
        raise _wrong(_column(node), f"the name '{name}'", "a name that begins with a letter, without '__'")


def _exponent(node: ast.expr) -> Fraction:
    """The number that an exponent is; raises BadInput if it is none or too large."""
    number = _constant(node)
    if number is None or abs(number) > HIGHEST_POWER:
        wanted = f"a number between −{HIGHEST_POWER:g} and {HIGHEST_POWER:g}"
        raise _wrong(_column(node), f"the exponent '{ast.unparse(node)[:40]}'", wanted)
    return number


def _constant(node: ast.expr) -> Fraction | None:
    match node:
        case ast.Constant(value=int() | float() as number):
            return Fraction(number).limit_denominator(1000)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            found = _constant(inner)
            return None if found is None else -found
        case ast.BinOp(op=ast.Div(), left=ast.Constant(value=int() as top), right=ast.Constant(value=int() as bottom)):
            return Fraction(top, bottom) if bottom else None
    return None


def _names(node: ast.expr) -> Iterator[ast.Name]:
    """Names that are no functions, in the order of the text."""
    match node:
        case ast.Name():
            yield node
        case ast.UnaryOp(operand=inner):
            yield from _names(inner)
        case ast.BinOp(left=left, right=right):
            yield from _names(left)
            yield from _names(right)
        case ast.Call(args=[argument]):
            yield from _names(argument)


def _units(formula: Formula, on: Quantity, stated: Mapping[str, str]) -> dict[str, str]:
    """Unit of every coefficient."""
    checking = _Dimensions(on)
    for name, text in stated.items():
        dimension = dimension_of(text)
        if dimension is None:
            raise BadInput(
                f"formula: found the unit '{text}' of {name}, wanted m, s, rad, K or V such as 's' or 'm/s²'"
            )
        checking.solved[f"?{name}"] = dimension
    whole = checking.of(formula.tree)
    si = checking.channel
    if not solve(whole, si, checking.solved):
        raise _wrong(_column(formula.tree), f"a term in {checking.shown(whole)}", f"{si}, the unit of the channel")
    found = {name: unknown(name).known(checking.solved) for name in formula.coefficients}
    for name, dimension in found.items():
        if dimension.unknowns and f"?{name}" not in checking.solved:
            column = next(_column(one) for one in _names(formula.tree) if one.id == name)
            raise _wrong(column, f"'{name}', whose unit the formula leaves open", _UNIT.format(name=name))
    return {name: str(dimension) for name, dimension in found.items()}


class _Dimensions:
    """Dimensional analysis of one formula for channels of one quantity; `solved` says what is known of coefficients."""

    def __init__(self, on: Quantity) -> None:
        self._on = on
        self.channel = cast(Dimension, dimension_of(SI[on]))
        self.solved: dict[str, Dimension] = {}

    def shown(self, dimension: Dimension) -> str:
        """For a message."""
        return str(dimension.known(self.solved))

    def of(self, node: ast.expr) -> Dimension:
        """Raises BadInput where unlike things are added or a function is given something with a unit."""
        match node:
            case ast.Name(id=name):
                return self._named(node, name)
            case ast.UnaryOp(operand=inner):
                return self.of(inner)
            case ast.BinOp(left=left, op=operation, right=right):
                return self._joined(left, operation, right)
            case ast.Call(func=ast.Name(id=name), args=[argument]):
                return self._applied(name, argument)
        return Dimension()

    def _named(self, node: ast.Name, name: str) -> Dimension:
        if name not in SIGNALS:
            return unknown(name)
        if name == "a" and self._on == "rate":
            raise _wrong(_column(node), "'a' for gyros", "u, the rate about the own axis, or x, y, z")
        return self.channel if name == "u" else cast(Dimension, dimension_of(SIGNALS[name]))

    def _joined(self, left: ast.expr, operation: ast.operator, right: ast.expr) -> Dimension:
        one = self.of(left)
        if isinstance(operation, ast.Pow):
            return one ** _exponent(right)
        other = self.of(right)
        if isinstance(operation, ast.Mult):
            return one * other
        if isinstance(operation, ast.Div):
            return one / other
        if not solve(one, other, self.solved):
            raise _wrong(_column(right), f"{self.shown(other)} beside {self.shown(one)}", "a sum of like quantities")
        return one

    def _applied(self, name: str, argument: ast.expr) -> Dimension:
        inner = self.of(argument)
        if name in _ANGLES and not solve(inner, Dimension(), self.solved):
            raise _wrong(_column(argument), f"{self.shown(inner)} in {name}", "a pure number or an angle")
        if name == "sqrt":
            return inner ** Fraction(1, 2)
        return inner if name == "abs" else Dimension()


def meets(text: str) -> bool:
    """Whether there is a place where all signals of a formula exist: the shaker's and the platter's never meet."""
    return bool(_together(parse(text), EVERYWHERE))


def _together(formula: Formula, places: Sequence[str]) -> tuple[str, ...]:
    """Those of the places where all signals of the formula exist."""
    return tuple(p for p in places if all(p in ONLY_AT.get(name, (p,)) for name in formula.signals))


def _narrowed(formula: Formula, places: Sequence[str]) -> tuple[str, ...]:
    found = _together(formula, places)
    if not found:
        column = next(_column(one) for one in _names(formula.tree) if places[0] not in ONLY_AT.get(one.id, places))
        raise _wrong(column, f"signals that no place of {_list(places)} has together", "signals of one place")
    return found


def _coordinates(formula: Formula, starts: Mapping[str, tuple[float, ...]]) -> tuple[Coordinate, ...]:
    """Linear coefficients start at zero unless told otherwise, the others where they are told to."""
    straight = _straight(formula)
    made = []
    for name in formula.coefficients:
        if name not in straight and not starts.get(name):
            column = next(_column(one) for one in _names(formula.tree) if one.id == name)
            raise _wrong(column, f"'{name}', in which the term is not proportional", _START.format(name=name))
        own = starts.get(name, (0.0,))
        step = LINEAR_STEP if name in straight else CURVED_STEP * (abs(own[0]) or 1.0)
        made.append(Coordinate(name, step, tuple(own)))
    return tuple(made)


def _straight(formula: Formula) -> tuple[str, ...]:
    """Coefficients to which, taken together, the formula is proportional."""
    names = formula.coefficients
    inside = {one.id for node in ast.walk(formula.tree) for one in _bent(node)}
    outside = [name for name in names if name not in inside]
    for size in range(len(outside), 0, -1):
        for chosen in itertools.combinations(outside, size):
            if _degree(formula.tree, chosen) == 1:
                return chosen
    return ()


def _bent(node: ast.AST) -> Iterator[ast.Name]:
    """Names below what is not linear."""
    match node:
        case ast.Call(args=[argument]):
            yield from _names(argument)
        case ast.BinOp(left=left, op=ast.Pow()):
            yield from _names(left)
        case ast.BinOp(op=ast.Div(), right=right):
            yield from _names(right)


def _degree(node: ast.expr, chosen: Sequence[str]) -> int | None:
    """Degree in the chosen coefficients of what is homogeneous in them, None of what is not."""
    match node:
        case ast.Name(id=name):
            return int(name in chosen)
        case ast.UnaryOp(operand=inner):
            return _degree(inner, chosen)
        case ast.BinOp(left=left, op=operation, right=right):
            one, other = _degree(left, chosen), _degree(right, chosen)
            if one is None or other is None:
                return None
            if isinstance(operation, ast.Mult):
                return one + other
            if isinstance(operation, ast.Div):
                return one - other
            if isinstance(operation, ast.Pow):
                return 0 if one == 0 else None
            return one if one == other else None
        case ast.Call(args=[argument]):
            return 0 if _degree(argument, chosen) == 0 else None
    return 0


def _column(node: ast.expr) -> int:
    return node.col_offset  # one parenthesis stood before the text


def _near(text: str, column: int) -> str:
    rest = text[column - 1 : column + 19].strip()
    return f"'{rest}'" if rest else "the end"


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)


def _wrong(column: int, found: str, wanted: str) -> BadInput:
    return BadInput(f"formula:{column} found {found}, wanted {wanted}")
