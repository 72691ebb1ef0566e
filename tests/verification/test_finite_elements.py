"""Steady flow in an L-shaped cavity against a solution by finite elements.

The reference is what `scripts/finite_elements.py cavity --reynolds 100 --size 0.01` prints; with
triangles twice as large it is off by 1.4e-4.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

import sphrom
from sphrom.reduction.reference_space import ReferenceMap

CASE = Path(sphrom.__file__).parents[1] / "cases" / "gallery" / "l_shaped_cavity.yaml"
REFERENCE = Path(__file__).parent / "data" / "l_shaped_cavity.csv"
FIELDS = ("position", "density_fluctuation", "velocity")
REYNOLDS, RESOLUTION, END, STEADY_FROM = 100.0, 24, 10.0, 8.0


def test_l_shaped_cavity(tmp_path: Path) -> None:
    """Measured, of the lid's speed: 0.015 at most and 0.005 r.m.s. at 24 across."""
    settings = {
        "parameters": {"train": {"reynolds": [REYNOLDS]}, "test": {"reynolds": []}},
        "discretization.resolution": RESOLUTION,
        "time.final_time": END,
    }
    study = sphrom.Study(CASE, set=settings, out=tmp_path, threads=1, quiet=True)
    study.run_stage("fom")
    with REFERENCE.open(newline="") as file:
        rows = list(csv.DictReader(file))
    exact = np.array([(float(row["u"]), float(row["v"])) for row in rows])
    coord = np.array([float(row["coord"]) for row in rows])
    upright = np.array([row["axis"] == "y" for row in rows])
    place = np.stack((np.where(upright, 0.25, coord), np.where(upright, coord, 0.75)), axis=1)
    spacing = study.case.plan.particle_spacing
    domain = study.case.scene.domain
    onto = ReferenceMap(place, domain, particle_spacing=spacing, smoothing_length=2.0 * spacing)
    with sphrom.open(next(tmp_path.glob("fom-*.h5"))) as run:
        last = run.isel(snapshot=run.time.values >= STEADY_FROM)
        snapshots = zip(*(last[name].values for name in FIELDS), strict=True)
        found = np.mean([onto(*fields)[1] for fields in snapshots], axis=0)
    error = np.abs(found - exact)
    assert np.sqrt(np.mean(error**2)) < 0.008
    assert error.max() < 0.02
