"""Vectors as tuples of two or three components, whose number the compiler knows."""

from __future__ import annotations

from typing import Any

from sphrom.kernels.jit import like, term

Vector = tuple[Any, ...]
"""A tuple of numbers, or of arrays (n_points,) with the components of many vectors."""


@term
def element(vectors: Vector, k: int) -> Vector:
    """Return vector k of many."""
    if len(vectors) == 2:
        return vectors[0][k], vectors[1][k]
    return vectors[0][k], vectors[1][k], vectors[2][k]


@term
def vector_like(vector: Vector, other: float) -> Vector:
    """Return a vector in the plane in the precision of a number."""
    return like(vector[0], other), like(vector[1], other)


@term
def plus(left: Vector, right: Vector) -> Vector:
    """Return the sum of two vectors."""
    if len(left) == 2:
        return left[0] + right[0], left[1] + right[1]
    return left[0] + right[0], left[1] + right[1], left[2] + right[2]


@term
def minus(left: Vector, right: Vector) -> Vector:
    """Return the difference of two vectors."""
    if len(left) == 2:
        return left[0] - right[0], left[1] - right[1]
    return left[0] - right[0], left[1] - right[1], left[2] - right[2]


@term
def times(factor: float, vector: Vector) -> Vector:
    """Return a multiple of a vector."""
    if len(vector) == 2:
        return factor * vector[0], factor * vector[1]
    return factor * vector[0], factor * vector[1], factor * vector[2]


@term
def dot(left: Vector, right: Vector) -> float:
    """Return the dot product of two vectors."""
    if len(left) == 2:
        return left[0] * right[0] + left[1] * right[1]
    return left[0] * right[0] + left[1] * right[1] + left[2] * right[2]
