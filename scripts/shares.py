"""What the first modes leave out of the snapshots of a run, by several readings of Eq. 4.3.

Reads the full and the mapped run of a folder of artifacts, and prints a table: sums of singular
values, as printed, or of their squares, of states that are stacked in different ways.

    python scripts/shares.py runs/reproduce/lid-driven-cavity/corrected --reynolds 100
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import sphrom
from sphrom.metrics.histories import cumulative_singular_value_share, energy

Array = NDArray[np.float64]
BLOCK = 5000
"""Particles that are read at once."""


def gram_matrices(path: Path) -> tuple[Array, Array, Array]:
    """Return Gram matrices of the snapshots, (n_snapshots, n_snapshots) each.

    They are those of relative densities, of their fluctuations, and of velocities [m2/s2].
    """
    with sphrom.open(path) as run:
        n_snapshots, n_particles = run.density_fluctuation.shape
        density, fluctuation, velocity = np.zeros((3, n_snapshots, n_snapshots))
        for first in range(0, n_particles, BLOCK):
            part = slice(first, first + BLOCK)
            changes = run.density_fluctuation[:, part].to_numpy()
            fluctuation += changes @ changes.T
            density += (1.0 + changes) @ (1.0 + changes).T
            for component in run.velocity[:, part].to_numpy().transpose(2, 0, 1):
                velocity += component @ component.T
    return density, fluctuation, velocity


def readings(
    density: Array, fluctuation: Array, velocity: Array, late: slice
) -> Mapping[str, Array]:
    """Return Gram matrices of stacked states, by what is stacked; `late` are snapshots."""
    stacked = density + velocity
    centre = np.eye(len(stacked)) - 1.0 / len(stacked)
    return {
        "density 1 kg/m3": stacked,
        "density 1000 kg/m3": 1e6 * density + velocity,
        "density alone": density,
        "velocity alone": velocity,
        "density's fluctuation": fluctuation + velocity,
        "less their mean": centre @ stacked @ centre,
        "from 1 s on": stacked[late, late],
        "every tenth snapshot": stacked[::10, ::10],
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--reynolds", default="100")
    parser.add_argument("--modes", type=int, nargs="+", default=[10, 20, 30])
    arguments = parser.parse_args()
    print(f"left out by M = {', '.join(map(str, arguments.modes))} [1e-6]")
    for space, stage in (("reference", "map"), ("Lagrangian", "fom")):
        path = arguments.folder / f"{stage}-reynolds{arguments.reynolds}.h5"
        with sphrom.open(path) as run:
            first = int(np.searchsorted(run.time.to_numpy(), 1.0))
        for name, gram in readings(*gram_matrices(path), slice(first, None)).items():
            values = np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[::-1], 0.0))
            for how, share in (
                ("values", cumulative_singular_value_share(values)),
                ("squares", energy(values)),
            ):
                left = [f"{1e4 * (100.0 - share[m - 1]):9.3g}" for m in arguments.modes]
                print(f"{space:10}  {name:22}  {how:7}  {' '.join(left)}")


if __name__ == "__main__":
    main()
