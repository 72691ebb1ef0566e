"""Expressions of flows, such as `0.1*sin(2*pi*y)`, evaluated without running Python code.

The text is parsed and may contain numbers, known names and functions only; numexpr evaluates it.
"""

from __future__ import annotations

import ast
import itertools
import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from inspect import signature
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.arrays import Array
from sphrom.text import shortened

if TYPE_CHECKING:
    from sphrom.scenes.histories import History

MAX_DEPTH = 50
"""Largest number of levels of nested brackets and operators."""
MOST_QUOTED = 80
"""Largest number of characters of an expression that a message quotes."""
FUNCTIONS = {
    "abs": 1, "arccos": 1, "arcsin": 1, "arctan": 1, "arctan2": 2, "cos": 1, "cosh": 1, "exp": 1,
    "log": 1, "log10": 1, "sin": 1, "sinh": 1, "sqrt": 1, "tan": 1, "tanh": 1, "where": 3,
}  # fmt: skip
"""Functions that numexpr evaluates, with their numbers of arguments."""
CALLED = ("interp", "max", "min")
"""Functions that are evaluated before the others, because numexpr lacks them."""
MOST_COMPILED = 1000
"""Largest number of texts whose trees and compiled forms are kept, because points of a case share
them."""
MOST_INPUTS = 30
"""Largest number of variables and calls of those functions that numexpr can take."""
CONSTANTS = {"pi": math.pi}
Histories = Mapping[str, "History | Function"]
Given = Mapping[str, Array | float]
"""Values of variables."""
_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd)
_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)


@dataclass(frozen=True)
class Function:
    """A Python function."""

    name: str
    call: Callable[..., Any]

    @property
    def arguments(self) -> list[str]:
        """The names of its arguments that have no default."""
        given = signature(self.call).parameters.values()
        return [one.name for one in given if one.default is one.empty]

    def __call__(self, *values: Array) -> Array:
        """Return its values in the shape of the arguments. Raises ValueError for another one."""
        shape = np.broadcast_shapes(*(np.shape(value) for value in values))
        found = np.asarray(self.call(*values), dtype=np.float64)
        if found.shape not in ((), shape):
            reason = f"must return values of the shape {shape}; got {found.shape}"
            raise ValueError(f"{self.name}: {reason}")
        return np.broadcast_to(found, shape)


class Expression:
    """A function of some variables.

    Parameters
    ----------
    text : the expression.
    variables : names whose values each evaluation passes.
    constants : values of further names.
    histories : functions of the time t, and functions of other arguments, by their names.

    Attributes
    ----------
    depends_on : the variables that the value depends on.

    Raises ValueError when the text is not an expression of these names.
    """

    def __init__(
        self,
        text: str,
        variables: tuple[str, ...],
        constants: Mapping[str, float] | None = None,
        histories: Histories = MappingProxyType({}),
    ) -> None:
        self.text = text
        self._variables, self._histories = variables, histories
        self._constants = {**CONSTANTS, **(constants or {})}
        self._tree = _parsed(text)
        _check(self._tree, (*variables, *self._constants), self._histories)
        self.depends_on = _names(self._tree) & frozenset(variables)
        plain = _Plain(self._constants, (*CALLED, *histories))
        self._plain = plain.visit(ast.parse(text.strip(), mode="eval").body)
        self._names = sorted(plain.names)
        self._calls = [self._call(node) for node in plain.calls.values()]

    def _call(self, node: ast.Call) -> Callable[[Given], Array]:
        """Return a function for the values of a call, given those of the variables."""
        name = _name(node)
        parts = [self._like(ast.unparse(part)) for part in node.args]
        _ = [part.compiled if part.depends_on else part.fixed for part in parts]
        if name in self._histories:
            return lambda given: self._histories[name](*[part._of(given) for part in parts])
        if name != "interp":
            chosen = np.minimum if name == "min" else np.maximum
            return lambda given: reduce(chosen, [part._of(given) for part in parts])
        if any(place.depends_on for place in parts[1::2]):
            raise ValueError(f"the places in '{_short(node)}' must be numbers or constants")
        places = [float(place.fixed) for place in parts[1::2]]
        if not all(low < high for low, high in itertools.pairwise(places)):
            raise ValueError(f"the places in '{_short(node)}' must increase")

        def interpolated(given: Given) -> Array:
            x = parts[0]._of(given)
            values = [value._of(given) for value in parts[2::2]]
            out = np.where(np.isnan(x), x, values[0])
            for n, low in enumerate(places[:-1]):
                share = np.clip((x - low) / (places[n + 1] - low), 0.0, 1.0)
                out = np.where(x > low, (1.0 - share) * values[n] + share * values[n + 1], out)
            return out

        return interpolated

    def _of(self, given: Given) -> Array:
        """Return the values in the shape of the variables that the expression depends on."""
        return self(**{n: given[n] for n in self.depends_on}) if self.depends_on else self.fixed

    @cached_property
    def fixed(self) -> Array:
        """The value of an expression that depends on no variable."""
        plain = self._plain  # a knot's value is often one constant, which need not be compiled
        return np.asarray(plain.value) if isinstance(plain, ast.Constant) else self()

    def _like(self, text: str, variables: tuple[str, ...] | None = None) -> Expression:
        """Return another expression of the same names, or of other variables."""
        return Expression(text, variables or self._variables, self._constants, self._histories)

    def read(self) -> Iterator[tuple[str, Expression]]:
        """Yield the histories that the expression reads, each with its time."""
        read = [n for n, one in self._histories.items() if not isinstance(one, Function)]
        for call in ast.walk(self._tree):
            if isinstance(call, ast.Call) and _name(call) in read:
                yield _name(call), self._like(ast.unparse(call.args[0]))

    def compared(self) -> Iterator[Expression]:
        """Yield the difference of the sides of each comparison."""
        for node in ast.walk(self._tree):
            if isinstance(node, ast.Compare):
                left = ast.unparse(node.left)
                right = ast.unparse(node.comparators[0])
                yield self._like(f"({left}) - ({right})")

    @cached_property
    def compiled(self) -> Callable[..., Any]:
        """The compiled expression. Raises ValueError where it can't be evaluated."""
        try:
            if len(self._names) > MOST_INPUTS:
                raise ValueError(f"it calls {', '.join(CALLED)} or histories too often")
            return _compiled(ast.unparse(self._plain), tuple(self._names))
        except (OverflowError, ZeroDivisionError, ValueError, TypeError) as error:
            reason = error.args[-1]
            raise ValueError(f"{_quoted(self.text)} can't be evaluated: {reason}") from error

    def __call__(self, **variables: Array | float) -> Array:
        """Return the values, in the shape to which the variables broadcast."""
        shape = np.broadcast_shapes(*(np.shape(value) for value in variables.values()))
        given = dict(variables)
        with np.errstate(all="ignore"):
            for n, call in enumerate(self._calls):
                given[f"_{n}"] = call(variables)
            inputs = (np.atleast_1d(given[name]).astype(float) for name in self._names)
            value = self.compiled(*inputs)
        values = np.asarray(value, dtype=np.float64)
        return np.broadcast_to(values, shape) if shape else values.reshape(())

    def degree_in(self, names: Collection[str]) -> float:
        """Return the degree as a polynomial in some names, infinite if it is not a polynomial.

        Degree one means affine in these names, and degree zero independent of them.
        """
        degrees = dict.fromkeys(names, 1.0)
        for name, called in self._histories.items():
            if not isinstance(called, Function):
                degrees[name] = called.degree_in(names)
        return _degree(self._tree, degrees)

    def separated(self, variable: str) -> tuple[Expression, Expression]:
        """Split the expression into a factor without a variable and one with this variable alone.

        Raises ValueError when it is not a product of two such factors.
        """
        without: list[str] = []
        alone: list[str] = []
        for factor, inverse in _factors(self._tree):
            used = self.depends_on & _names(factor)
            if variable in used and used != {variable}:
                raise ValueError(
                    f"{_quoted(self.text)} must be a field times an amplitude, such as "
                    f"sin(y)*cos(t); in '{_short(factor)}' {variable} is mixed with "
                    "other variables"
                )
            text = f"({ast.unparse(factor)})"
            (alone if variable in used else without).append(f"1/{text}" if inverse else text)
        others = tuple(name for name in self._variables if name != variable)
        return (
            self._like("*".join(without) or "1", others),
            self._like("*".join(alone) or "1", (variable,)),
        )


def _degree(node: ast.AST, degrees: Mapping[str, float]) -> float:
    """Return the degree of an expression, given those of names and histories."""
    parts = [_degree(part, degrees) for part in ast.iter_child_nodes(node)]
    if isinstance(node, ast.Name):
        return degrees.get(node.id, 0.0)
    if isinstance(node, ast.BinOp):
        left, _, right = parts
        if isinstance(node.op, ast.Add | ast.Sub):
            return max(left, right)
        if isinstance(node.op, ast.Mult):
            return left + right
        if isinstance(node.op, ast.Div) and right == 0.0:
            return left
    elif isinstance(node, ast.Call):
        function, place, *knots = parts
        if _name(node) == "interp" and not any((place, *knots[::2])):
            return max(knots[1::2])
        if not any((place, *knots)):
            return function
    elif isinstance(node, ast.UnaryOp):
        return parts[1]
    return math.inf if any(parts) else 0.0


def _factors(node: ast.expr, inverse: bool = False) -> Iterator[tuple[ast.expr, bool]]:
    """Yield the factors of a product, each with whether it is a divisor."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        yield from _factors(node.left, inverse)
        yield from _factors(node.right, inverse != isinstance(node.op, ast.Div))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield ast.UnaryOp(ast.USub(), ast.Constant(1.0)), False
        yield from _factors(node.operand, inverse)
    else:
        yield node, inverse


class _Plain(ast.NodeTransformer):
    """Replaces some calls by names such as `_0`, and constants by numbers.

    All numbers become floats, so that `9**9**9` overflows.
    """

    def __init__(self, constants: Mapping[str, float], called: Collection[str]) -> None:
        self._constants, self._called = constants, called
        self.calls: dict[str, ast.Call] = {}
        """The calls by their texts, except those within others of them."""
        self.names: set[str] = set()
        """The names that remain, apart from those of functions."""

    def visit_Call(self, node: ast.Call) -> ast.expr:
        if _name(node) not in self._called:
            node.args = [self.visit(part) for part in node.args]
            return node
        text = ast.unparse(node)
        self.calls.setdefault(text, node)
        self.names.add(name := f"_{[*self.calls].index(text)}")
        return ast.Name(name)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self._constants:
            return ast.Constant(float(self._constants[node.id]))
        self.names.add(node.id)
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return ast.Constant(float(node.value))  # type: ignore[arg-type]


@lru_cache(MOST_COMPILED)
def _compiled(text: str, names: tuple[str, ...]) -> Callable[..., Any]:
    import numexpr  # late, because few scenes need it

    numexpr.set_num_threads(1)
    with np.errstate(all="ignore"):
        return numexpr.NumExpr(text, [(name, np.float64) for name in names])


@lru_cache(MOST_COMPILED)
def _parsed(text: str) -> ast.expr:
    """Return the syntax tree of a text, with at most MAX_DEPTH levels, safe for recursion.

    It must not be changed, because expressions of the same text share it.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(f"{_quoted(text)} is not an expression") from error
    level: list[ast.AST] = [tree.body]
    for _ in range(MAX_DEPTH):
        level = [part for node in level for part in ast.iter_child_nodes(node)]
    if level:
        raise ValueError(f"an expression may have at most {MAX_DEPTH} nested levels")
    return tree.body


def _names(node: ast.expr) -> frozenset[str]:
    return frozenset(part.id for part in ast.walk(node) if isinstance(part, ast.Name))


def _name(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else _short(call.func)


def _quoted(text: str) -> str:
    return f"'{shortened(text, MOST_QUOTED)}'"


def _short(node: ast.expr) -> str:
    return shortened(ast.unparse(node), MOST_QUOTED)


def _check(whole: ast.expr, known: tuple[str, ...], histories: Histories) -> None:
    """Raise ValueError unless an expression has only numbers, known names and functions."""
    parts = [whole]
    for node in parts:  # the list grows during the loop
        if isinstance(node, ast.Call) and not node.keywords:
            parts += _arguments(node, histories)
        elif isinstance(node, ast.BinOp) and isinstance(node.op, _OPERATORS):
            parts += [node.left, node.right]
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, _OPERATORS):
            parts.append(node.operand)
        elif isinstance(node, ast.Name):
            if node.id in histories:
                raise ValueError(f"{node.id} is a history; write {node.id}(t)")
            if node.id not in known:
                raise ValueError(f"{_short(node)} is not a known name; use {', '.join(known)}")
        elif not (isinstance(node, ast.Constant) and type(node.value) in (int, float)):
            raise ValueError(
                f"'{_short(node)}' is not allowed: use numbers, + - * / **, {', '.join(known)} and "
                f"the functions {', '.join((*FUNCTIONS, *CALLED, *histories))}"
            )
        elif not abs(node.value) <= sys.float_info.max:  # type: ignore[arg-type]
            raise ValueError(f"{_short(node)} is too large")


def _arguments(node: ast.Call, histories: Histories) -> list[ast.expr]:
    """Return the arguments of a call; a condition is replaced by its two sides."""
    name = _name(node)
    number = len(node.args)
    if isinstance(function := histories.get(name), Function):
        if number != len(function.arguments):
            needed = ", ".join(function.arguments)
            raise ValueError(f"{name} takes {needed}; got {number} arguments")
        return node.args
    if name in histories:
        used = _names(node)
        if number != 1 or "t" not in used or used & {"x", "y"}:
            raise ValueError(f"{name} is a history, which takes a time, such as {name}(t)")
        return node.args
    if name == "interp" and (number < 5 or number % 2 == 0):
        reason = "a variable, then places and values in turn, such as interp(t, 0, 0, 2, 1)"
        raise ValueError(f"interp takes {reason}; got {number} arguments")
    if name in CALLED:
        if number < 2:
            raise ValueError(f"{name} takes two or more arguments; got {number}")
        return node.args
    if name not in FUNCTIONS:
        known = ", ".join((*FUNCTIONS, *CALLED, *histories))
        raise ValueError(f"{_short(node.func)} is not a known function; use {known}")
    if number != FUNCTIONS[name]:
        raise ValueError(f"{name} takes {FUNCTIONS[name]} arguments; got {number}")
    if name != "where":
        return node.args
    condition, *others = node.args
    one = isinstance(condition, ast.Compare) and len(condition.ops) == 1
    if not one or not isinstance(condition.ops[0], _COMPARISONS):  # type: ignore[attr-defined]
        raise ValueError("where needs a comparison first, such as where(y > 1, u, 0)")
    return [condition.left, *condition.comparators, *others]  # type: ignore[attr-defined]
