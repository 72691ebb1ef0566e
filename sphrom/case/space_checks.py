"""Checks of flows in three dimensions, and of keys that are only for two."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphrom.case.custom_scene import CustomScene
    from sphrom.case.models import Case

Found = Iterator[tuple[str, str]]

NOT_IN_SPACE = ("solids", "terms", "fluid", "resistance", "porous", "inflow")
"""Keys for two dimensions only."""


def check_axes(scene: CustomScene) -> None:
    """Raise ValueError unless vectors have a component for each axis of the box.

    A three-dimensional box with keys that are only for two dimensions is refused too.
    """
    n_axes = len(scene.axes)
    if "z" in scene.box.periodic and n_axes == 2:
        raise ValueError("box.periodic: z needs three coordinates in box.lower and upper")
    vectors = {f"walls.{name}.velocity": wall.velocity for name, wall in scene.walls.items()}
    vectors["body_force"] = scene.body_force if any(scene.body_force) else None
    for key, vector in vectors.items():
        if vector is not None and len(vector) != n_axes:
            reason = f"must have {n_axes} components, one along each axis of the box"
            raise ValueError(f"{key}: {reason}; got {len(vector)}")
    if n_axes == 2:
        if scene.initial.w != 0.0:
            raise ValueError("initial.w: is for three-dimensional boxes; leave it out")
        return
    usual = type(scene).model_fields
    for key in NOT_IN_SPACE:
        if getattr(scene, key) != usual[key].default:
            raise ValueError(f"{key}: is only supported in two dimensions; leave it out")
    if scene.slip == "free":
        raise ValueError("slip: walls of a three-dimensional box have friction; set slip: none")
    if scene.initial.file is not None:
        raise ValueError("initial.file: is only supported in two dimensions; give expressions")


def check_space(case: Case) -> Found:
    """Refuse keys that are only supported in two dimensions if the flow has three."""
    if case.scene.domain.n_dim == 2:
        return
    section = case.discretization
    reason = "in three dimensions"
    for key, value, needed in (
        ("discretization.viscosity", section.viscosity, "laplacian"),
        ("discretization.shifting.form", section.shifting.form, "sun"),
        ("discretization.shifting.transport", section.shifting.transport, "advective"),
        ("discretization.walls.kind", section.walls.kind, "mirrored"),
        ("discretization.walls.layers", section.walls.layers, None),
        ("reference.method", case.reference.method, "mls"),
        ("reference.points", case.reference.points, "lattice"),
    ):
        if value != needed:
            yield key, f"must be {needed or 'left out'} {reason}; got {value}"
    if case.basis.lagrangian:
        yield "basis.lagrangian", f"is not supported {reason}; leave it out"
    fast = any(model.from_operators for model in case.rom)
    for name in case.scene.measured_walls if fast else ():
        forces = "only full runs have forces on walls"
        yield f"scene.measure.{name}", f"{forces} {reason}; leave it out, or set rom: []"
    if case.psi.kind == "polyharmonic":
        yield "psi.kind", f"must be b-spline {reason}; got polyharmonic"
    for i, model in enumerate(case.rom):
        if not model.from_operators:
            yield f"rom.{i}.evaluation", f"must be operators {reason}; got particles"
