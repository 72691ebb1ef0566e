"""Flow past walls by finite elements, to compare particles with: P2 velocities, P1 pressures.

- `array`: slow flow through a square or a hexagonal array of cylinders, on a quarter of a cell. The
  drag over viscosity and mean velocity, F / (mu U), of a pressure gradient over the whole cell.
- `cavity`: steady flow in the L-shaped cavity of `cases/gallery/l_shaped_cavity.yaml`, by Newton's
  method: u along x = 0.25, and v along y = 0.75.

Prints CSV. It needs an environment of its own, with neither sphrom nor what sphrom needs:

    python -m venv fe
    fe/bin/pip install scikit-fem==12.0.2 gmsh==4.15.2
    fe/bin/python scripts/finite_elements.py array --lattice hexagonal --share 0.2
    fe/bin/python scripts/finite_elements.py cavity --reynolds 100
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Any

import gmsh
import numpy as np
import skfem
from scipy.sparse import bmat
from skfem import BilinearForm, LinearForm
from skfem.helpers import ddot, div, dot, grad, mul

N_LINE = 21
TOLERANCE, MAX_STEPS = 1e-11, 20
QUADRATURE = 6


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
        """Return the unknowns of velocity components at edges where a function says so."""
        found = self.velocity.get_dofs(lambda x: where(x))
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

    @BilinearForm
    def carried(u: Any, v: Any, w: Any) -> Any:
        return dot(mul(grad(u), w["now"]) + mul(grad(w["now"]), u), v)

    @LinearForm
    def carries(v: Any, w: Any) -> Any:
        return dot(mul(grad(w["now"]), w["now"]), v)

    for _ in range(MAX_STEPS):
        now = basis.interpolate(state[:n])
        momentum = flow.friction / reynolds
        rates = flow.system(momentum) @ state
        rates[:n] += carries.assemble(basis, now=now)
        matrix = flow.system(momentum + carried.assemble(basis, now=now))
        change = skfem.solve(*skfem.condense(matrix, -rates, D=fixed))
        state = state + change
        if np.abs(change).max() < TOLERANCE:
            break
    else:
        raise RuntimeError("Newton's method did not converge")
    place = np.linspace(0.0, 1.0, N_LINE)[1:-1]
    lines = {"y": (np.full(len(place), 0.25), place), "x": (place, np.full(len(place), 0.75))}
    rows = []
    for axis, line in lines.items():
        found = (basis.probes(np.array(line)) @ state[:n]).reshape(2, -1)
        rows += [(axis, *values) for values in zip(place, *found, strict=True)]
    return rows


def main() -> None:
    """Read the arguments, solve, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flow", choices=("array", "cavity"))
    parser.add_argument("--lattice", choices=("square", "hexagonal"), default="square")
    parser.add_argument("--share", type=float, default=0.2, help="of an array that is solid")
    parser.add_argument("--reynolds", type=float, default=100.0)
    parser.add_argument("--size", type=float, help="of triangles, over the radius or the cavity")
    given = parser.parse_args()
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if given.flow == "array":
        found = drag(given.lattice, given.share, given.size or 0.05)
        print(f"{given.lattice},{given.share:g},{found:.5f}")
    else:
        print("re,axis,coord,u,v")
        for axis, place, u, v in cavity(given.reynolds, given.size or 0.02):
            print(f"{given.reynolds:g},{axis},{place:.2f},{u:.6f},{v:.6f}")
    gmsh.finalize()


if __name__ == "__main__":
    main()
