"""The sections of a custom scene, and which of its constants can vary.

Walls and the force have to be affine in what varies: operators are projected once for all values,
and each parameter that drives the flow has a part of its own, which its value multiplies.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from sphrom.case.fields import Coordinate, Section, key
from sphrom.case.shapes import Point
from sphrom.expressions import MOST_QUOTED, Expression
from sphrom.text import shortened

Value = Coordinate | Annotated[str, Field(max_length=1000)]
"""A number, or an expression."""
Vector = Annotated[tuple[Value, ...], Field(min_length=2, max_length=2)]


class BoxSection(Section):
    """The box that the flow is in."""

    lower: Point = key((0.0, 0.0), "its lower left corner", unit="m")
    upper: Point = key((1.0, 1.0), "its upper right corner", unit="m")
    periodic: tuple[Literal["x", "y"], ...] = key((), "axes along which the flow repeats")


class MovingWallSection(Section):
    """How a wall slides along itself."""

    velocity: Vector | None = key(None, "its velocity, numbers or expressions in x, y", unit="m/s")
    rotation: Coordinate | None = key(
        None, "its rate of rotation about its centroid, anticlockwise", unit="rad/s"
    )


class InitialSection(Section):
    """The fields that a run starts with: numbers or expressions in x, y."""

    u: Value = key(0.0, "velocity along x", unit="m/s")
    v: Value = key(0.0, "velocity along y", unit="m/s")
    p: Value = key(0.0, "pressure", unit="Pa")


class DrivingExpression(NamedTuple):
    """An expression that drives the flow, as far as it varies in space."""

    where: str
    """Its key in the scene."""
    factor: str
    """The parameter that multiplies it; empty where none does."""
    expression: Expression


def parameter_problems(
    names: Collection[str],
    constants: Collection[str],
    others: Collection[str],
    drives: Sequence[DrivingExpression],
) -> Iterator[tuple[str, str]]:
    """Yield those of some parameters that can't vary, and why.

    `others` are names of parameters that aren't constants.
    """
    varied = [name for name in names if name in constants]
    for name in varied:
        if name in others:
            yield name, "is a constant's name and a wall's or the force's; rename the constant"
    for where, factor, expression in drives:
        found = [one for one in varied if expression.degree_in([one]) > 0.0]
        degree = expression.degree_in(varied) + (factor in names)
        if found and degree > 1.0 and factor in names:
            yield found[0], f"multiplies {factor}, which varies too, in {where}; vary one of them"
        elif degree > 1.0:
            together = "" if len(found) == 1 else f", together with {', '.join(found[1:])}"
            yield (
                found[0],
                f"{where} must be a constant part plus {found[0]} times another{together}, for "
                "operators are projected once for all values; got "
                f"'{shortened(expression.text, MOST_QUOTED)}'",
            )


def driving(
    names: Collection[str], walls: Collection[str], drives: Sequence[DrivingExpression]
) -> tuple[str, ...]:
    """Return those of some parameters that walls' velocities or the force's field depend on."""

    def drives_flow(name: str) -> bool:
        return name in walls or any(each.expression.degree_in([name]) > 0.0 for each in drives)

    return tuple(name for name in names if drives_flow(name))
