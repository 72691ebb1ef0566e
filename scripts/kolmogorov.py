"""How fast waves grow on Kolmogorov flow, U = sin y, in full runs and by a reduced model.

In a box of 4 pi by 2 pi the linear equations give a growth rate of 0.13847 at Re 5, and none at
Re 2.0489 (the eigenvalues of Orr and Sommerfeld's equation by Fourier series, which `exact_growth`
computes). Re is 1/nu, of the flow's speed and 1/wavenumber.

- `full`: waves grow in runs of `cases/gallery/kolmogorov.yaml` with the force nu sin y. Their rate
  is fitted to the amplitude of cos(x/2) in v, after the other modes have died out. sin(x/2), which
  the start lacks, shows the noise of particles. It is what limits the rate: at the onset, where
  waves stay as small as they start, they start with 5 % of the flow's speed. From there they change
  the flow themselves, by 0.6 % of the Re of the onset.
- `reduced`: the largest real part of the Jacobian's eigenvalues in the case's own model, on the
  flow without waves. That is the steady state below the onset, in proportion to the force over
  viscosity. Newton's method isn't used near the onset: modes aren't exactly symmetric, so that the
  branches don't meet there, and it finds a flow with waves.

    python scripts/kolmogorov.py full --resolution 32
    python scripts/kolmogorov.py reduced
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import sphrom

CASE = Path(__file__).parent.parent / "cases" / "gallery" / "kolmogorov.yaml"
WAVELENGTH = 2.0 * math.pi
WAVENUMBER = 0.5
FORCE = 0.2
"""Of the case, over which it has Re = FORCE / nu^2 [m/s2]."""
N_HARMONICS = 16
GROWING, NEAR_ONSET = 0.01, 0.05
"""The amplitudes that waves start with [m/s]."""
FROM, TO = 8.0, 16.0
"""The times between which rates are fitted [s]."""
NAMES = ("growth rate at Re 5", "onset")
NEAR = (1.8, 2.0, 2.3)
"""Re on both sides of the onset."""
STABLE, UNSTABLE = 1.6, 3.0


def exact_growth(reynolds: float) -> float:
    """Return the largest growth rate of waves on sin y, of the linear equations."""
    number = np.arange(-N_HARMONICS, N_HARMONICS + 1)
    laplacian = -np.diag(WAVENUMBER**2 + number.astype(float) ** 2)
    shear = (np.eye(len(number), k=-1) - np.eye(len(number), k=1)) / 2j
    advection = -1j * WAVENUMBER * shear @ (laplacian + np.eye(len(number)))
    rates = np.linalg.solve(laplacian, advection + laplacian @ laplacian / reynolds)
    return float(np.linalg.eigvals(rates).real.max())


def exact_onset() -> float:
    """Return the Re at which waves begin to grow."""
    return float(brentq(exact_growth, STABLE, UNSTABLE))


def full_growth(
    reynolds: float, amplitude: float, resolution: int, mach: float, out: Path
) -> float:
    """Return the growth rate in a full run, and print it with its noise."""
    viscosity = 1.0 / reynolds
    settings = {
        "scene.body_force": [f"{viscosity!r}*sin(y)", 0],
        "scene.initial.v": f"{amplitude}*cos(x/2)",
        "scene.initial.p": f"{-0.8 * amplitude}*cos(y)*sin(x/2)",
        "fluid.mach_number": mach,
        "discretization.resolution": resolution,
        "parameters.train.reynolds": [WAVELENGTH * reynolds],
        "parameters.test.reynolds": [],
        "time.final_time": TO,
    }
    study = sphrom.Study(CASE, set=settings, out=out / f"{reynolds}", quiet=True)
    study.run_stage("fom")
    (path,) = study.folder.glob("fom-*.h5")
    with sphrom.open(path) as run:
        time = run.time.values
        wave = np.exp(-1j * WAVENUMBER * run.position.values[:, :, 0])
        waves = 2.0 * np.mean(run.velocity.values[:, :, 1] * wave, axis=1)
    middle = 0.5 * (FROM + TO)
    rates = [fitted(time, waves.real, *ends) for ends in ((FROM, TO), (FROM, middle), (middle, TO))]
    noise = np.abs(waves.imag).max() / np.abs(waves.real).max()
    print(
        f"Re {reynolds:.4g}: growth rate {rates[0]:.5f}, exact {exact_growth(reynolds):.5f}; "
        f"{rates[1]:.5f} and {rates[2]:.5f} in the halves of the time; noise {100 * noise:.2g} %",
        flush=True,
    )
    return rates[0]


def fitted(time: np.ndarray, amplitude: np.ndarray, start: float, end: float) -> float:
    """Return the exponential rate of an amplitude between two times."""
    when = (time >= start) & (time <= end)
    return float(np.polyfit(time[when], np.log(np.abs(amplitude[when])), 1)[0])


def full(resolution: int, mach: float, out: Path) -> tuple[float, float]:
    """Return the growth rate at Re 5 and the Re of the onset, by full runs."""
    growth = full_growth(5.0, GROWING, resolution, mach, out)
    near = [full_growth(reynolds, NEAR_ONSET, resolution, mach, out) for reynolds in NEAR]
    # Through three points; their rates rise.
    return growth, float(np.polyval(np.polyfit(near, NEAR, 2), 0.0))


def reduced_growth(study: sphrom.Study) -> Callable[[float], float]:
    """Return the growth rate as a function of Re, by the study's model."""
    model = study.model(study.models[0], reynolds=case_reynolds(STABLE))
    found = model.steady(model.start)
    assert found.converged
    flow = found.coordinates / speed(STABLE)

    def growth(reynolds: float) -> float:
        jacobian = model.at(reynolds=case_reynolds(reynolds)).jacobian(speed(reynolds) * flow)
        return float(np.linalg.eigvals(jacobian).real.max()) / speed(reynolds)

    return growth


def speed(reynolds: float) -> float:
    """Return the largest speed [m/s] of the case's flow at Re."""
    return math.sqrt(FORCE * reynolds)


def case_reynolds(reynolds: float) -> float:
    """Return the case's Reynolds number, of 1 m/s and a wavelength."""
    return WAVELENGTH * math.sqrt(reynolds / FORCE)


def reduced(resolution: int, mach: float, n_modes: int, out: Path) -> tuple[float, float]:
    """Return the growth rate at Re 5 and the Re of the onset, by a reduced model."""
    settings = {
        "discretization.resolution": resolution,
        "fluid.mach_number": mach,
        "rom.0.n_modes": n_modes,
    }
    study = sphrom.Study(CASE, set=settings, out=out / f"reduced-{n_modes}", quiet=True)
    study.run(until="operators")
    growth = reduced_growth(study)
    return growth(5.0), float(brentq(growth, STABLE, UNSTABLE))


def main() -> None:
    """Read the arguments, run, and print errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", choices=("full", "reduced"))
    parser.add_argument("--resolution", type=int, default=32, help="particles along a wavelength")
    parser.add_argument("--mach", type=float, default=0.1)
    parser.add_argument("--modes", type=int, default=8, help="of the reduced model")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        numbers = given.resolution, given.mach
        if given.model == "full":
            growth, onset = full(*numbers, Path(folder))
        else:
            growth, onset = reduced(*numbers, given.modes, Path(folder))
    exact = exact_growth(5.0), exact_onset()
    for name, found, true in zip(NAMES, (growth, onset), exact, strict=True):
        print(f"{name}: {found:.5f}, exact {true:.5f}: {100 * (found / true - 1):+.2f} %")


if __name__ == "__main__":
    main()
