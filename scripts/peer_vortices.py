"""Runs of the Taylor-Green vortex by another program, for `bench_errors.py`.

Runs in an environment of its own, without sphrom. Prints one line of JSON: the processor
time of the steps, without compilation, and the error of the velocity at the end.

    python scripts/peer_vortices.py edac STATE.npz
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version

import numpy as np

COURANT = 0.25
"""(c0 + U) dt / h, as in the cases of both programs."""


def time_step(state: dict[str, np.ndarray]) -> float:
    """Return the step [s]."""
    length = float(state["smoothing_length"])
    viscous = 0.125 * length**2 / float(state["kinematic_viscosity"])
    return min(COURANT * length / (float(state["sound_speed"]) + 1.0), viscous)


def run_pysph(name: str, state: dict[str, np.ndarray]) -> dict[str, object]:
    """Return time and results of a scheme of PySPH, with its own integrator."""
    from pysph.base.kernels import WendlandQuintic
    from pysph.base.nnps import DomainManager, LinkedListNNPS
    from pysph.base.utils import get_particle_array
    from pysph.sph.scheme import TVFScheme
    from pysph.sph.wc.edac import EDACScheme

    spacing = float(state["spacing"])
    length = float(state["smoothing_length"])
    density = float(state["reference_density"])
    sound = float(state["sound_speed"])
    common = {
        "fluids": ["fluid"], "solids": [], "dim": 2, "rho0": density, "c0": sound,
        "nu": float(state["kinematic_viscosity"]), "pb": density * sound**2,
    }  # fmt: skip
    if name == "tvf":
        scheme = TVFScheme(**common, p0=density * sound**2, h0=length)
    else:
        scheme = EDACScheme(**common, h=length)
    x, y = state["position"]
    u, v = state["velocity"]
    fluid = get_particle_array(
        name="fluid", x=x, y=y, u=u, v=v, m=density * spacing**2, h=length, rho=density,
        p=state["pressure"],
    )  # fmt: skip
    step = time_step(state)
    n_steps = round(float(state["final_time"]) / step)
    step = float(state["final_time"]) / n_steps
    kernel = WendlandQuintic(dim=2)
    scheme.configure_solver(kernel=kernel, tf=n_steps * step, dt=step, pfreq=10 * n_steps)
    scheme.setup_properties([fluid])
    solver = scheme.get_solver()
    box = DomainManager(
        xmin=0.0, xmax=1.0, ymin=0.0, ymax=1.0, periodic_in_x=True, periodic_in_y=True
    )
    nearest = LinkedListNNPS(2, [fluid], radius_scale=kernel.radius_scale, domain=box)
    solver.set_disable_output(True)
    solver.set_parallel_manager(None)
    solver.setup([fluid], scheme.get_equations(), nearest, kernel=kernel)
    started = time.process_time()
    solver.solve(show_progress=False)
    seconds = time.process_time() - started
    position = np.stack((fluid.x, fluid.y))[:, : x.size]
    velocity = np.stack((fluid.u, fluid.v))[:, : x.size]
    return {
        "seconds": seconds,
        "n_steps": int(solver.count),
        "error": error(position, velocity, float(solver.t), state),
        "version": version("pysph"),
    }


def run_jax(name: str, state: dict[str, np.ndarray]) -> dict[str, object]:
    """Return time and results of JAX-SPH with transport velocities (its `tvf: 1`), float64."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    from jax_sph import partition
    from jax_sph.eos import TaitEoS
    from jax_sph.integrator import si_euler
    from jax_sph.jax_md import space
    from jax_sph.jax_md.partition import Sparse
    from jax_sph.solver import WCSPH
    from jax_sph.utils import Tag

    spacing = float(state["spacing"])
    density = float(state["reference_density"])
    sound = float(state["sound_speed"])
    step = time_step(state)
    n_steps = round(float(state["final_time"]) / step)
    step = float(state["final_time"]) / n_steps
    stiffness = density * sound**2
    box = np.array([1.0, 1.0])
    displacement, shift = space.periodic(side=box)
    # The solver takes its kernel's length from the spacing: 1.3 of it, for Wendland's.
    spread = float(state["smoothing_length"]) / 1.3
    solver = WCSPH(
        displacement, TaitEoS(stiffness, density, 0.0, 1.0), lambda place: jnp.zeros_like(place),
        spread, 2, step, sound, kernel="WC2K",
    )  # fmt: skip
    advance = jax.jit(si_euler(1.0, solver.forward_wrapper(), shift, lambda now: now, None))
    place = jnp.asarray(state["position"].T)
    velocity = jnp.asarray(state["velocity"].T)
    n = len(place)
    numbers = jnp.ones(n)
    now = {
        "r": place, "tag": jnp.full(n, Tag.FLUID, dtype=int), "u": velocity, "v": velocity,
        "dudt": jnp.zeros_like(place), "dvdt": jnp.zeros_like(place), "drhodt": 0.0 * numbers,
        "rho": density * numbers, "p": jnp.asarray(state["pressure"]),
        "mass": density * spacing**2 * numbers,
        "eta": density * float(state["kinematic_viscosity"]) * numbers,
        "dTdt": 0.0 * numbers, "T": numbers, "kappa": 0.0 * numbers, "Cp": numbers,
        "nw": jnp.zeros_like(place),
    }  # fmt: skip
    search = partition.neighbor_list(
        displacement, box, r_cutoff=solver._kernel_fn.cutoff, backend="jaxmd_vmap",
        capacity_multiplier=1.25, mask_self=False, format=Sparse, num_particles_max=n,
        pbc=np.array([True, True]),
    )  # fmt: skip
    near = search.allocate(now["r"], num_particles=n)
    first, near = advance(0.0, now, near)
    first["v"].block_until_ready()
    now = first
    started = time.process_time()
    for _ in range(n_steps):
        following, nearer = advance(step, now, near)
        if nearer.did_buffer_overflow:
            near = search.allocate(now["r"], num_particles=n)
            following, nearer = advance(step, now, near)
        now = following
        near = nearer
    now["v"].block_until_ready()
    seconds = time.process_time() - started
    position = np.asarray(now["r"]).T
    return {
        "seconds": seconds,
        "n_steps": n_steps,
        "error": error(position, np.asarray(now["u"]).T, n_steps * step, state),
        "version": version("jax-sph"),
    }


def error(
    position: np.ndarray, velocity: np.ndarray, time: float, state: dict[str, np.ndarray]
) -> float:
    """Return the relative L2 error [%] of velocities (2, n) at positions (2, n) and a time [s]."""
    wave = 2.0 * np.pi
    x, y = wave * position
    exact = np.stack((np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)))
    exact *= np.exp(-2.0 * float(state["kinematic_viscosity"]) * wave**2 * time)
    return float(100.0 * np.linalg.norm(velocity - exact) / np.linalg.norm(exact))


if __name__ == "__main__":
    called = run_jax if sys.argv[1] == "jax-sph" else run_pysph
    print(json.dumps(called(sys.argv[1], dict(np.load(sys.argv[2])))))
