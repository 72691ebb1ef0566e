"""Flow past walls by finite elements, to compare particles with: P2 velocities, P1 pressures.

- `array`: slow flow through a square or a hexagonal array of cylinders, on a quarter of a cell. The
  drag over viscosity and mean velocity, F / (mu U), of a pressure gradient over the whole cell.
- `cavity`: steady flow in the L-shaped cavity of `cases/gallery/l_shaped_cavity.yaml`, by Newton's
  method: u along x = 0.25, and v along y = 0.75.
- `polygon`: steady flow, periodic along x, that a uniform force drives past a polygon in a channel:
  flow rate, drag, and u and v along x = 0.

Prints CSV. It needs an environment of its own, with neither sphrom nor what sphrom needs:

    python -m venv fe
    fe/bin/pip install scikit-fem==12.0.2 gmsh==4.15.2
    fe/bin/python scripts/finite_elements.py array --lattice hexagonal --share 0.2
    fe/bin/python scripts/finite_elements.py cavity --reynolds 100
    fe/bin/python scripts/finite_elements.py polygon --corners 1,1 2,1 2,2 1,2 --box 3,3
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Any

import gmsh
import numpy as np
import skfem
from scipy.sparse import bmat, csr_matrix, eye
from skfem import BilinearForm, LinearForm
from skfem.helpers import ddot, div, dot, grad, mul

N_LINE = 21
TOLERANCE, MAX_STEPS = 1e-11, 20
QUADRATURE = 6
FORCES = (0.1, 0.3, 0.6, 1.0)
"""Shares of a force by which flow gets faster, so that Newton's method converges at each."""


def mesh_of(surface: int, size: float) -> skfem.MeshTri:
    """Return the triangles of a surface of gmsh's model."""
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.setSize(gmsh.model.getEntities(0), size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(2)
    tags, points, _ = gmsh.model.mesh.getNodes(2, surface, includeBoundary=True)
    _, _, (corners,) = gmsh.model.mesh.getElements(2, surface)
    tags, first = np.unique(tags, return_index=True)
    used, corner = np.unique(np.searchsorted(tags, corners), return_inverse=True)
    places = points.reshape(-1, 3)[first][used, :2]
    return skfem.MeshTri(np.ascontiguousarray(places.T), corner.reshape(-1, 3).T.astype(int))


@dataclass
class Flow:
    """The spaces of velocity and pressure on a mesh, and the forms of the equations."""

    mesh: skfem.MeshTri

    def __post_init__(self) -> None:
        element = skfem.ElementVector(skfem.ElementTriP2())
        self.velocity = skfem.Basis(self.mesh, element, intorder=QUADRATURE)
        self.pressure = self.velocity.with_element(skfem.ElementTriP1())
        friction = BilinearForm(lambda u, v, w: ddot(grad(u), grad(v)))
        self.friction = friction.assemble(self.velocity)
        divergence = BilinearForm(lambda u, q, w: -div(u) * q)
        self.divergence = divergence.assemble(self.velocity, self.pressure)

    def system(self, momentum: Any) -> Any:
        """Return the matrix of velocities and pressures."""
        return bmat([[momentum, self.divergence.T], [self.divergence, None]], "csr")

    def components(self, where: Any, *axes: int) -> np.ndarray:
        """Return the unknowns of velocity components on the outline where a function says so."""
        edges = self.mesh.facets_satisfying(lambda x: where(x), boundaries_only=True)
        found = self.velocity.get_dofs(edges)
        return np.concatenate([found.all(f"u^{axis + 1}") for axis in axes])


def drag(lattice: str, share: float, size: float) -> float:
    """Return F / (mu U) of an array whose cell has the area of one cylinder's."""
    cell = np.array([1.0, 1.0]) if lattice == "square" else np.array([1.0, math.sqrt(3.0)])
    in_cell = 1 if lattice == "square" else 2
    width, height = 0.5 * cell
    radius = math.sqrt(share * cell.prod() / (in_cell * math.pi))
    gmsh.model.add("array")
    box = gmsh.model.occ.addRectangle(0, 0, 0, width, height)
    centres = [(0.0, 0.0), (width, height)][:in_cell]
    discs = [(2, gmsh.model.occ.addDisk(*centre, 0, radius, radius)) for centre in centres]
    ((_, fluid),), _ = gmsh.model.occ.cut([(2, box)], discs)
    flow = Flow(mesh_of(fluid, size * radius))

    def on_cylinder(x: np.ndarray) -> np.ndarray:
        away = [np.hypot(x[0] - a, x[1] - b) for a, b in centres]
        return np.min(away, axis=0) < radius * (1.0 + 1e-6)

    def on_side(x: np.ndarray) -> np.ndarray:
        return np.min(np.abs([x[0], x[0] - width, x[1], x[1] - height]), axis=0) < 1e-9

    # The flow is the mirror image of itself about all four sides.
    fixed = np.concatenate((flow.components(on_cylinder, 0, 1), flow.components(on_side, 1)))
    load = LinearForm(lambda v, w: v[0]).assemble(flow.velocity)
    right = np.concatenate((load, np.zeros(flow.pressure.N)))
    found = skfem.solve(*skfem.condense(flow.system(flow.friction), right, D=np.unique(fixed)))
    # A gradient of one over a cell of one cylinder, whose mean velocity is that of the quarter.
    mean = load @ found[: flow.velocity.N] / (width * height)
    return float(cell.prod() / in_cell / mean)


def steady(
    flow: Flow, state: np.ndarray, viscosity: float, load: Any, fixed: Any, same: Any
) -> Any:
    """Return the steady flow (velocities, pressures), with `fixed` unknowns as in a first state.

    `load` is the force on velocities, `same` the matrix that gives all unknowns from free ones.
    """
    basis, n = flow.velocity, flow.velocity.N
    forced = np.concatenate((load, np.zeros(flow.pressure.N)))

    @BilinearForm
    def carried(u: Any, v: Any, w: Any) -> Any:
        return dot(mul(grad(u), w["now"]) + mul(grad(w["now"]), u), v)

    @LinearForm
    def carries(v: Any, w: Any) -> Any:
        return dot(mul(grad(w["now"]), w["now"]), v)

    for _ in range(MAX_STEPS):
        now = basis.interpolate(state[:n])
        momentum = viscosity * flow.friction
        rates = flow.system(momentum) @ state - forced
        rates[:n] += carries.assemble(basis, now=now)
        matrix = same.T @ flow.system(momentum + carried.assemble(basis, now=now)) @ same
        change = same @ skfem.solve(*skfem.condense(matrix.tocsr(), -(same.T @ rates), D=fixed))
        state = state + change
        if np.abs(change).max() < TOLERANCE:
            return state, rates
    raise RuntimeError("Newton's method did not converge")


def cavity(reynolds: float, size: float) -> list[tuple[float, ...]]:
    """Return axis, place, u and v along two lines of the L-shaped cavity."""
    gmsh.model.add("cavity")
    box = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
    step = gmsh.model.occ.addRectangle(0.5, 0, 0, 0.5, 0.5)
    ((_, fluid),), _ = gmsh.model.occ.cut([(2, box)], [(2, step)])
    flow = Flow(mesh_of(fluid, size))
    basis, n = flow.velocity, flow.velocity.N
    state = np.zeros(n + flow.pressure.N)
    lid = flow.components(lambda x: x[1] > 1.0 - 1e-9, 0)
    along = basis.doflocs[0, lid]
    state[lid] = 16.0 * along**2 * (1.0 - along) ** 2
    # One pressure is fixed as well.
    fixed = np.append(basis.get_dofs().all(), n)
    state, _ = steady(
        flow, state, 1.0 / reynolds, np.zeros(n), fixed, eye(len(state), format="csr")
    )
    place = np.linspace(0.0, 1.0, N_LINE)[1:-1]
    lines = {"y": (np.full(len(place), 0.25), place), "x": (place, np.full(len(place), 0.75))}
    rows = []
    for axis, line in lines.items():
        found = (basis.probes(np.array(line)) @ state[:n]).reshape(2, -1)
        rows += [(axis, *values) for values in zip(place, *found, strict=True)]
    return rows


def past_polygon(
    corners: np.ndarray, box: np.ndarray, viscosity: float, force: float, size: float
) -> tuple[float, float, list[tuple[float, ...]]]:
    """Return flow rate, drag, and rows of y, u and v along x = 0; the fluid's density is one.

    Triangles are up to `size` wide, and a thirtieth of it at corners.
    """
    width, height = box
    gmsh.model.add("polygon")
    occ, mesh = gmsh.model.occ, gmsh.model.mesh
    points = [occ.addPoint(*corner, 0) for corner in corners]
    edges = [occ.addLine(*ends) for ends in zip(points, points[1:] + points[:1], strict=True)]
    solid = occ.addPlaneSurface([occ.addCurveLoop(edges)])
    ((_, fluid),), _ = occ.cut([(2, occ.addRectangle(0, 0, 0, width, height))], [(2, solid)])
    occ.synchronize()
    left, right = (
        [
            tag
            for _, tag in gmsh.model.getEntitiesInBoundingBox(
                x - e, -e, -e, x + e, height + e, e, 1
            )
        ]
        for x, e in ((0.0, 1e-6), (width, 1e-6))
    )
    mesh.setPeriodic(1, right, left, [1, 0, 0, width, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    near, graded = mesh.field.add("Distance"), mesh.field.add("Threshold")
    places = {tag: gmsh.model.getValue(0, tag, [])[:2] for _, tag in gmsh.model.getEntities(0)}
    sharp = [tag for tag, at in places.items() if np.hypot(*(corners - at).T).min() < 1e-6]
    mesh.field.setNumbers(near, "PointsList", sharp)
    widths = {
        "InField": near,
        "SizeMin": size / 30.0,
        "SizeMax": size,
        "DistMin": 0,
        "DistMax": 0.5,
    }
    for name, value in widths.items():
        mesh.field.setNumber(graded, name, value)
    mesh.field.setAsBackgroundMesh(graded)
    flow = Flow(mesh_of(fluid, size))
    basis, n = flow.velocity, flow.velocity.N

    def unknowns(where: Any, *axes: int) -> list[np.ndarray]:
        """Return those of velocities along axes, and then those of the pressure."""
        pressures = flow.pressure.get_dofs(lambda x: where(x)).all() + n
        return [*(flow.components(where, axis) for axis in axes), pressures]

    place = np.hstack((basis.doflocs, flow.pressure.doflocs))
    ends = [unknowns(lambda x, at=at: np.abs(x[0] - at) < 1e-9, 0, 1) for at in (0.0, width)]
    owner = np.arange(place.shape[1])
    for one, other in zip(*ends, strict=True):
        owner[other[np.argsort(place[1, other])]] = one[np.argsort(place[1, one])]
    _, column = np.unique(owner, return_inverse=True)
    same = csr_matrix((np.ones(len(owner)), (np.arange(len(owner)), column)))
    inside = (1e-9, width - 1e-9, 1e-9, height - 1e-9)
    on_solid = flow.components(
        lambda x: (x[0] > inside[0]) & (x[0] < inside[1]) & (x[1] > inside[2]) & (x[1] < inside[3]),
        0,
        1,
    )
    on_walls = flow.components(lambda x: (x[1] < inside[2]) | (x[1] > inside[3]), 0, 1)
    # One pressure is fixed as well.
    fixed = np.unique(column[np.concatenate((on_solid, on_walls, [n]))])
    load = force * LinearForm(lambda v, w: v[0]).assemble(basis)
    state = np.zeros(len(owner))
    for share in FORCES:
        state, rates = steady(flow, state, viscosity, share * load, fixed, same)
    along = np.isin(on_solid, flow.components(lambda x: x[1] > -1.0, 0))
    line = np.linspace(0.0, height, N_LINE)[1:-1]
    found = (basis.probes(np.array((np.full(len(line), 1e-9), line))) @ state[:n]).reshape(2, -1)
    drag = -float(rates[on_solid[along]].sum())
    return float(load @ state[:n]) / force / width, drag, list(zip(line, *found, strict=True))


def main() -> None:
    """Read the arguments, solve, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flow", choices=("array", "cavity", "polygon"))
    parser.add_argument("--lattice", choices=("square", "hexagonal"), default="square")
    parser.add_argument("--share", type=float, default=0.2, help="of an array that is solid")
    parser.add_argument("--reynolds", type=float, default=100.0)
    square = ["1,1", "2,1", "2,2", "1,2"]
    parser.add_argument("--corners", nargs="+", default=square, help="of a polygon, each x,y")
    parser.add_argument("--box", default="3,3", help="width and height of its channel")
    parser.add_argument("--viscosity", type=float, default=1.0, help="of flow past it")
    parser.add_argument("--force", type=float, default=1.0, help="on fluid around it")
    parser.add_argument("--size", type=float, help="of triangles, over the radius or the cavity")
    given = parser.parse_args()
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if given.flow == "array":
        found = drag(given.lattice, given.share, given.size or 0.05)
        print(f"{given.lattice},{given.share:g},{found:.5f}")
    elif given.flow == "polygon":
        corners, box = (
            np.array([[float(number) for number in pair.split(",")] for pair in pairs])
            for pairs in (given.corners, [given.box])
        )
        size = given.size or 0.06
        rate, force, rows = past_polygon(corners, box[0], given.viscosity, given.force, size)
        print(f"flow rate,{rate:.6f}\ndrag,{force:.6f}\ny,u,v")
        for row in rows:
            print(",".join(f"{value:.6f}" for value in row))
    else:
        print("re,axis,coord,u,v")
        for axis, place, u, v in cavity(given.reynolds, given.size or 0.02):
            print(f"{given.reynolds:g},{axis},{place:.2f},{u:.6f},{v:.6f}")
    gmsh.finalize()


if __name__ == "__main__":
    main()
