"""PySPH's side of `bench_peers.py`; runs in an environment of its own, which sphrom is not in.

Times right-hand sides of PySPH's delta-SPH (its WCSPHScheme, with the density diffusion that takes
renormalised gradients) followed by the Fickian shift (Lind et al. 2012), at given particles.

    python scripts/pysph_taylor_green.py STATE.npz REPEATS
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version

import numpy as np


def evaluator(state: dict[str, np.ndarray]):
    """Return PySPH's evaluator of one right-hand side, and its equations' names."""
    from pysph.base.kernels import WendlandQuintic
    from pysph.base.nnps import DomainManager
    from pysph.base.utils import get_particle_array
    from pysph.sph.equation import Group
    from pysph.sph.scheme import WCSPHScheme
    from pysph.sph.wc.shift import FickianShift
    from pysph.tools.sph_evaluator import SPHEvaluator

    spacing, length = float(state["spacing"]), float(state["smoothing_length"])
    density = float(state["reference_density"])
    x, y = state["position"]
    u, v = state["velocity"]
    fluid = get_particle_array(
        name="fluid", x=x, y=y, u=u, v=v, m=density * spacing**2, h=length,
        rho=density + state["density_fluctuation"],
    )  # fmt: skip
    scheme = WCSPHScheme(
        ["fluid"], [], dim=2, rho0=density, c0=float(state["sound_speed"]), h0=length,
        hdx=length / spacing, nu=float(state["kinematic_viscosity"]), gamma=7.0, alpha=0.0,
        beta=0.0, delta=0.1, delta_sph=True,
    )  # fmt: skip
    kernel = WendlandQuintic(dim=2)
    scheme.configure_solver(kernel=kernel, tf=1.0, dt=1e-4)
    scheme.setup_properties([fluid])
    fluid.add_property("dpos", stride=3)
    shift = FickianShift("fluid", ["fluid"], hdx=length / spacing, tensile_correction=True)
    groups = [*scheme.get_equations(), Group(equations=[shift])]
    domain = DomainManager(
        xmin=0.0, xmax=1.0, ymin=0.0, ymax=1.0, periodic_in_x=True, periodic_in_y=True
    )
    names = [type(equation).__name__ for group in groups for equation in group.equations]
    return SPHEvaluator([fluid], groups, dim=2, kernel=kernel, domain_manager=domain), names


def main() -> None:
    """Time right-hand sides and print JSON."""
    state = dict(np.load(sys.argv[1]))
    evaluation, names = evaluator(state)
    whole, alone = [], []
    for _ in range(int(sys.argv[2]) + 1):
        started = time.process_time()
        evaluation.update()
        searched = time.process_time()
        evaluation.evaluate(dt=1e-9)
        ended = time.process_time()
        whole.append(ended - started)
        alone.append(ended - searched)
    # The first one warms up.
    print(
        json.dumps(
            {
                "version": version("pysph"),
                "equations": names,
                "seconds": float(np.median(whole[1:])),
                "seconds_without_search": float(np.median(alone[1:])),
            }
        )
    )


if __name__ == "__main__":
    main()
