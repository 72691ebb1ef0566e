"""Which constants of a custom scene can vary: walls and the force have to be affine in them.

Operators are projected once for all values. Each parameter that drives the flow has a part of its
own, which its value multiplies.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from sphrom.expressions import MOST_QUOTED, Expression
from sphrom.text import shortened


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
