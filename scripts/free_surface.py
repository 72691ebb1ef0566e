"""The full model with a free surface, beside exact solutions, theory and an experiment.

Runs cases of the gallery, and prints a table for each part:

- `rest`: fluid at rest in the tank of `standing_wave`, for twenty periods unless another number is
  given: the largest velocity over sqrt(g H), after the first period too, and the r.m.s. error of
  pressure over rho g H.
- `real-water`: water at rest for ten periods in five tanks: the largest speed over sqrt(g H).
- `wave` and `high-wave`: standing waves of 0.05 and 0.2 H over five periods: frequency over that of
  linear theory, and the rate of decay over 2 nu k^2, from the fluid's moment with the wave's
  potential, beside linear theory with viscosity and the correction of the frequency by Tadjbakhsh
  and Keller (J. Fluid Mech. 8, 1960).
- `shallow`: the wave of 0.05 H in a tank filled to 0.3 m; 12 rows unless another number is given.
  Also its pressure at half the depth, zero to six spacings from the wall, over that of linear
  theory for the run's own amplitude.
- `drop`: the drop's semi-axes, from its second moments, beside the ordinary differential equations.
- `dam`: the front of the collapsing column beside Martin and Moyce (Phil. Trans. A 244, 1952), and
  `dam-causes`: the same from hydrostatic pressure, without slip, and with less viscosity.
- `noslip`: a wave at Re 1,000 between walls that fluid sticks to, beside theory of Stokes layers.
- `evenness`: how evenly particles lie at the end of a high wave, of the drop and of the column.
- `pictures`: the pictures of the gallery and of the page about free surfaces.

    python scripts/free_surface.py wave --resolution 32 64 --ratio 2 2.5
    python scripts/free_surface.py rest --resolution 64 --periods 5
    python scripts/free_surface.py rest drop dam noslip evenness pictures

Runs and `free_surface.json`, with all figures so far, are kept in `runs/free_surface`.
"""

from __future__ import annotations

import argparse
import cmath
import json
import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import yaml
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit
from scipy.spatial import cKDTree
from small_picture import write_small

from sphrom.api.study import Study
from sphrom.plots.panels import COLOURS, EXACT_COLOUR, SPEED_MAP, new_figure, save, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROOT = Path(__file__).parents[1]
GALLERY, FIGURES = ROOT / "cases" / "gallery", ROOT / "docs" / "figures"
HEIGHT, WAVE_NUMBER = 0.5, math.pi
OMEGA = 1.6974449
"""Of the first wave [rad/s]."""
PERIOD = 2.0 * math.pi / OMEGA
TANKS: dict[str, dict[str, Any]] = {
    "1.2 x 0.4": {},
    "1 x 1": {"box__upper": [1.0, 1.5], "level": 1.0},
    "1 x 0.15": {"box__upper": [1.0, 0.3], "level": 0.15},
    "with a step": {"solids": {"step": {"rectangle": {"lower": [0.8, 0.0], "upper": [1.2, 0.2]}}}},
    "with a slope": {"solids": {"slope": {"polygon": [[0.6, 0.0], [1.2, 0.0], [1.2, 0.3]]}}},
}
"""Of real water."""
FRONT = {0.832: 1.217, 1.997: 2.292, 3.345: 4.134}
"""Martin and Moyce: z / a at t sqrt(2 g / a)."""
DROP_PERIOD = 4.567375
WIDTH = 1100
"""Of a picture [pixels]."""
SPACING = "particle_spacing"


@dataclass(frozen=True)
class Run:
    """A full run of a case of the gallery, as stored."""

    time: np.ndarray
    position: np.ndarray
    """(n_snapshots, n_particles, 2) [m]."""
    velocity: np.ndarray
    pressure: np.ndarray
    box: np.ndarray
    """Its lower and its upper corner (2, 2) [m]."""
    viscosity: float
    spacing: float
    probes: np.ndarray
    """(n_snapshots, n_probes), measured pressures."""


class Runs:
    """Makes full runs of the gallery's cases, once each, in a folder."""

    def __init__(self, folder: Path, threads: int, keys: dict[str, Any]) -> None:
        self.folder, self._threads, self._keys = folder, threads, keys

    def __call__(self, name: str, resolution: int | None = None, **changes: Any) -> Run:
        """Return a run of a case, with keys changed; `a__b` stands for `a.b`."""
        keys = {key.replace("__", "."): value for key, value in changes.items()}
        if resolution is not None:
            keys["discretization.resolution"] = resolution
        keys |= self._keys
        told = zlib.crc32(repr(sorted(keys.items())).encode())
        folder = self.folder / f"{name}-{told:08x}"
        study = Study(
            GALLERY / f"{name}.yaml", set=keys, out=folder, threads=self._threads, quiet=True
        )
        study.run(until="fom")
        section = study.case.scene.box
        box = np.array((section.lower, section.upper))
        with h5py.File(next(study.folder.glob("fom-*.h5"))) as run:
            fields = [run[key][()] for key in ("time", "position", "velocity", "pressure")]
            probes = [part["pressure"][()].ravel() for part in run.get("measure", {}).values()]
            attributes = [run.attrs[key] for key in ("kinematic_viscosity", SPACING)]
            return Run(*fields, box, *attributes, np.array(probes).T)


def damped(t: np.ndarray, *shape: float) -> np.ndarray:
    """Return a damped oscillation about a mean."""
    sine, cosine, mean, rate, decay = shape
    return mean + np.exp(-decay * t) * (sine * np.sin(rate * t) + cosine * np.cos(rate * t))


def frequency(height: float) -> float:
    """Return that of the first wave in a tank filled to a height [rad/s], by linear theory."""
    return math.sqrt(WAVE_NUMBER * math.tanh(WAVE_NUMBER * height))


def moment_of(run: Run) -> np.ndarray:
    """Return the fluid's moment (n_snapshots,) with the potential of the first wave."""
    x, y = np.moveaxis(WAVE_NUMBER * run.position, -1, 0)
    return np.mean(np.cos(x) * np.cosh(y), axis=1)


def rate_and_decay(run: Run, omega: float = OMEGA) -> tuple[float, float]:
    """Return the frequency [rad/s] and the rate of decay [1/s] of a run's first wave."""
    moment = moment_of(run)
    start = (np.ptp(moment) / 2.0, 0.0, moment.mean(), omega, 0.03)
    shape = curve_fit(damped, run.time, moment, start)[0]
    return float(shape[3]), float(shape[4])


def rest(runs: Runs, resolution: int, periods: float = 20.0) -> dict[str, float]:
    """Return figures of fluid at rest over a number of periods."""
    run = runs(
        "standing_wave",
        resolution,
        scene__constants__amplitude=0.0,
        time__final_time=periods * PERIOD,
        snapshots__every=20,
    )
    speed = np.hypot(*np.moveaxis(run.velocity, -1, 0)).max(axis=1) / math.sqrt(HEIGHT)
    error = (run.pressure - (HEIGHT - run.position[..., 1])) / HEIGHT
    late = run.time > PERIOD
    return {
        "velocity / sqrt(g H), from the start": float(speed.max()),
        "velocity / sqrt(g H), after a period": float(speed[late].max()),
        "velocity / sqrt(g H), last half": float(speed[2.0 * run.time > run.time[-1]].max()),
        "pressure / (rho g H), r.m.s.": float(np.sqrt(np.mean(error[late] ** 2))),
        "pressure / (rho g H), largest": float(np.abs(error[late]).max()),
    }


def real_water(runs: Runs, rows: int) -> dict[str, float]:
    """Return the largest speeds over sqrt(g H) of real water at rest, in tanks of five shapes."""
    found = {}
    for tank, scene in TANKS.items():
        box = scene.get("box__upper", [1.2, 0.8])
        level = scene.get("level", 0.4)
        k = math.pi / box[0]
        changes = {f"scene__{key}": value for key, value in scene.items() if key == "solids"}
        run = runs(
            "standing_wave",
            rows,
            scene__box__upper=box,
            scene__fluid={"level": level, "gravity": 9.81},
            scene__constants__amplitude=0.0,
            scene__reference_length=level,
            fluid__reference_speed=math.sqrt(9.81 * level),
            parameters__train__reynolds=[1e6 * level * math.sqrt(9.81 * level)],
            time__final_time=20.0 * math.pi / math.sqrt(9.81 * k * math.tanh(k * level)),
            snapshots__every=20,
            **changes,
        )
        speed = np.hypot(*np.moveaxis(run.velocity, -1, 0)).max(axis=1) / math.sqrt(9.81 * level)
        first = run.time < 0.1 * run.time[-1]
        found[f"{tank}, first period"] = float(speed[first].max())
        found[f"{tank}, then"] = float(speed[~first].max())
    return found


def viscous_wave(viscosity: float, height: float = HEIGHT) -> tuple[float, float]:
    """Return the frequency and the rate of decay of a low wave of viscous fluid [1/s].

    Its rate s is a root of (s + 2 nu k^2)^2 + g k tanh(k H) = 4 nu^2 k^3 m tanh(k H) / tanh(m H),
    where m^2 = k^2 + s / nu: neither the surface nor the floor has shear stress. For deep fluid
    it is in Lamb, Hydrodynamics, section 349.
    """
    omega = frequency(height)
    rate = complex(0.0, omega)
    for _ in range(50):
        m = cmath.sqrt(WAVE_NUMBER**2 + rate / viscosity)
        shear = 4.0 * viscosity**2 * WAVE_NUMBER**3 * m * math.tanh(WAVE_NUMBER * height)
        rate = 1j * cmath.sqrt(omega**2 - shear / cmath.tanh(m * height))
        rate -= 2.0 * viscosity * WAVE_NUMBER**2
    return rate.imag, -rate.real


def wave(
    runs: Runs, resolution: int, share: float = 0.05, height: float = HEIGHT, **changes: Any
) -> dict[str, float]:
    """Return figures of a wave whose height is a share of the depth, over five periods."""
    amplitude, omega = share * height, frequency(height)
    changes = {"scene__constants__amplitude": amplitude, **changes}
    run = runs("standing_wave", resolution, time__final_time=10.0 * math.pi / omega, **changes)
    rate, decay = rate_and_decay(run, omega)
    friction = 2.0 * run.viscosity * WAVE_NUMBER**2
    t2 = math.tanh(WAVE_NUMBER * height) ** 2
    bend = (9.0 / t2**2 - 12.0 / t2 - 3.0 - 2.0 * t2) / 64.0
    # The correction is with the square of the amplitude, of which the fit sees the mean.
    mean = np.mean(np.exp(-2.0 * friction * run.time))
    low_rate, low_decay = viscous_wave(run.viscosity, height)
    bent = bend * (WAVE_NUMBER * amplitude) ** 2 * mean
    found = {
        "frequency / linear theory": rate / omega,
        "the same by theory": low_rate / omega + bent,
        "decay / (2 nu k^2)": decay / friction,
        "the same by linear theory": low_decay / friction,
    }
    if run.probes.size:
        found |= wall_pressure(run, height)
    return found


def wall_pressure(run: Run, height: float) -> dict[str, float]:
    """Return pressures at half the depth over those of linear theory for the run's own wave."""
    moment = moment_of(run)
    level = 2.0 * height * (moment - moment.mean()) / math.cosh(WAVE_NUMBER * height)
    depth = math.cosh(0.5 * WAVE_NUMBER * height) / math.cosh(WAVE_NUMBER * height)
    found = {}
    for n, pressure in enumerate(run.probes.T):
        slope = np.polyfit(level, pressure, 1)[0]
        at = math.cos(WAVE_NUMBER * n * run.spacing)
        found[f"pressure / linear theory, {n} spacings from the wall"] = slope / (depth * at)
    return found


def shallow(runs: Runs, rows: int) -> dict[str, float]:
    """Return figures of a low wave in a tank filled to 0.3 m, with its pressure beside a wall."""
    height = 0.3
    places = {f"at{n}": {"probe": [n * height / rows, 0.5 * height]} for n in range(7)}
    scale = f"amplitude*omega/{math.sinh(WAVE_NUMBER * height)!r}"
    return wave(
        runs,
        rows,
        height=height,
        scene__fluid__level=height,
        scene__reference_length=height,
        scene__measure=places,
        scene__constants__omega=frequency(height),
        scene__initial__u=f"{scale}*cosh(pi*y)*sin(pi*x)",
        scene__initial__v=f"-{scale}*sinh(pi*y)*cos(pi*x)",
        fluid__reference_speed=math.sqrt(height),
    )


def high_wave(runs: Runs, resolution: int) -> dict[str, float]:
    """Return figures of a wave of 0.2 H."""
    return wave(runs, resolution, 0.2)


def no_slip(runs: Runs, resolution: int) -> dict[str, float]:
    """Return figures of a low wave at Re 1,000 between walls that fluid sticks to.

    Layers of thickness sqrt(2 nu / omega) on the floor and both ends take energy at the mean rate
    rho U^2 sqrt(nu omega / 2) / 2 per area, and lower the frequency as much as they damp (Mei and
    Liu, J. Fluid Mech. 59, 1973; Landau and Lifshitz, Fluid Mechanics, sections 24 and 25).
    """
    run = runs(
        "standing_wave",
        resolution,
        scene__slip="none",
        scene__constants__amplitude=0.05 * HEIGHT,
        parameters__train__reynolds=[1000],
        time__final_time=5.0 * PERIOD,
    )
    rate, decay = rate_and_decay(run)
    k, nu = WAVE_NUMBER, run.viscosity
    depth = math.sinh(2.0 * k * HEIGHT)
    low_rate, low_decay = viscous_wave(nu)
    layers = math.sqrt(0.5 * nu * OMEGA) * 2.0 * k / depth * (0.5 + depth / (2.0 * k) - HEIGHT)
    return {
        "frequency / linear theory": rate / OMEGA,
        "the same with layers": (low_rate - layers) / OMEGA,
        "decay [1/s]": decay,
        "the same by theory [1/s]": layers + low_decay,
    }


def ellipse(time: np.ndarray) -> np.ndarray:
    """Return the exact semi-axes (2, n_times) of the drop."""

    def rates(t: float, state: np.ndarray) -> tuple[float, float, float]:
        stretch, a, b = state
        return (stretch**2 + 1.0) * (b**2 - a**2) / (b**2 + a**2), stretch * a, -stretch * b

    ends = 0.0, float(time[-1])
    found = solve_ivp(rates, ends, (0.5, 1.0, 1.0), t_eval=time, rtol=1e-10, atol=1e-12)
    return found.y[1:]


def axes_of(run: Run) -> np.ndarray:
    """Return the semi-axes (2, n_snapshots) of the ellipse with a run's second moments."""
    return 2.0 * np.sqrt(np.mean(run.position**2, axis=1)).T


def drop(runs: Runs, resolution: int) -> dict[str, float]:
    """Return figures of the drop over three periods."""
    run = runs("oscillating_drop", resolution)
    axes = axes_of(run)
    # The lattice's area differs from the circle's, and the equations hold for drops of any size.
    error = np.abs(axes / axes[:, :1] / ellipse(run.time) - 1.0)
    return {
        "largest error of semi-axes": float(error.max()),
        "the same over the first period": float(error[:, run.time < DROP_PERIOD].max()),
    }


def dam(runs: Runs, resolution: int, **changes: Any) -> dict[str, float]:
    """Return the front of the collapsing column, beside the measured one."""
    last = max(FRONT) / math.sqrt(2.0) + 0.1
    box = [6.0, 3.0]
    changes |= {"scene__box__upper": box, "time__final_time": last}
    run = runs("dam_break", resolution, **changes)
    front = run.position[..., 0].max(axis=1) + 0.5 * run.spacing
    scaled = run.time * math.sqrt(2.0)
    return {
        f"front at {at:g}, measured {known:g}": float(np.interp(at, scaled, front))
        for at, known in FRONT.items()
    }


def dam_causes(runs: Runs, resolution: int) -> dict[str, float]:
    """Return the front of columns that differ in a possible cause of its lead."""
    causes: dict[str, dict[str, Any]] = {
        "hydrostatic": {"scene__initial__p": "2-y"},
        "no slip": {"scene__slip": "none"},
        "Re 20,000": {"parameters__train__reynolds": [20000]},
    }
    return {
        f"{cause}: {name}": value
        for cause, changes in causes.items()
        for name, value in dam(runs, resolution, **changes).items()
    }


def evenness(runs: Runs, resolution: int) -> dict[str, float]:
    """Return how evenly particles lie at the ends of the gallery's runs, below the surface.

    On a lattice twelve others are within 2.1 spacings; beside a void there are far fewer.
    """
    found = {}
    for name in ("standing_wave", "oscillating_drop", "dam_break"):
        run = runs(name, resolution)
        last, spacing = run.position[-1], run.spacing
        tree = cKDTree(last)
        deep = tree.query_ball_point(last, 4.0 * spacing, return_length=True) > 40
        nearest = tree.query(last[deep], 2)[0][:, 1] / spacing
        count = tree.query_ball_point(last[deep], 2.1 * spacing, return_length=True) - 1
        found |= {
            f"{name}: nearest neighbour / spacing, least": float(nearest.min()),
            f"{name}: the same, mean": float(nearest.mean()),
            f"{name}: neighbours within 2.1 spacings, mean": float(count.mean()),
            f"{name}: the same, least": float(count.min()),
        }
    return found


PARTS: dict[str, tuple[Callable[[Runs, int], dict[str, float]], tuple[int, ...]]] = {
    "rest": (rest, (32, 64)),
    "wave": (wave, (32, 64)),
    "high-wave": (high_wave, (32, 64)),
    "shallow": (shallow, (12, 15, 30)),
    "real-water": (real_water, (12, 24)),
    "drop": (drop, (20, 40)),
    "dam": (dam, (30, 60)),
    "dam-causes": (dam_causes, (30,)),
    "noslip": (no_slip, (32, 64)),
    "evenness": (evenness, (30,)),
}
"""What measures, and the resolutions by default."""


def draw(runs: Runs) -> None:
    """Draw the gallery's cases: particles coloured by speed, and a history beside theory."""
    frames = {
        "standing_wave": ((0.25, 0.5, 3.25), PERIOD),
        "oscillating_drop": ((0.2, 0.5, 2.7), DROP_PERIOD),
        "dam_break": ((1.2, 2.0, 2.6), 1.0),
    }
    for name, (instants, unit) in frames.items():
        run = runs(name)
        with styled():
            figure = new_figure(9.6, 2.7)
            *panels, last = figure.subplots(1, 4)
            for panel, instant in zip(panels, instants, strict=True):
                _draw_particles(panel, run, instant * unit, run.box)
            _draw_history(last, name, run)
            last.set_box_aspect(0.75)
        source = runs.folder / f"{name}.png"
        save(figure, source)
        path = FIGURES / f"gallery-{name}.png"
        write_small(source, path, WIDTH)
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB")


def _draw_particles(axes: Axes, run: Run, at: float, box: np.ndarray) -> None:
    """Draw a run's particles at a time, in colours of their speed."""
    k = int(np.argmin(np.abs(run.time - at)))
    speed, (width, height) = np.hypot(*run.velocity[k].T), box[1] - box[0]
    dot = (150.0 * run.spacing / max(width, height)) ** 2
    fastest = np.hypot(*np.moveaxis(run.velocity, -1, 0)).max()
    colours = {"cmap": SPEED_MAP, "vmin": 0.0, "vmax": fastest}
    axes.scatter(*run.position[k].T, c=speed, s=dot, linewidths=0.0, **colours)
    axes.set(title=f"speed, t = {run.time[k]:.2f} s", aspect="equal", xlabel="x [m]")
    axes.set(xlim=box[:, 0], ylim=box[:, 1], ylabel="y [m]")


def _draw_history(axes: Axes, name: str, run: Run) -> None:
    """Draw what is known of a flow over time, and the run's."""
    time, fine = run.time, np.linspace(0.0, run.time[-1], 400)
    known = {"color": EXACT_COLOUR, "linewidth": 3.0}
    axes.set(xlabel="t [s]")
    if name == "dam_break":
        fell = time < 2.0  # then it arrives at the far wall
        front = run.position[fell, :, 0].max(axis=1) + 0.5 * run.spacing
        axes.plot(time[fell], front, color=COLOURS[0], label="front")
        at = np.array(list(FRONT)) / math.sqrt(2.0)
        axes.plot(
            at[:2], list(FRONT.values())[:2], "o", color=EXACT_COLOUR, label="measured (1952)"
        )
        axes.set(title="front along the floor", ylabel="x [m]")
    elif name == "oscillating_drop":
        for index, (exact, found) in enumerate(zip(ellipse(fine), axes_of(run), strict=True)):
            axes.plot(fine, exact, **known, label="exact" if index == 0 else None)
            axes.plot(time, found, color=COLOURS[index], label=f"along {'xy'[index]}")
        axes.set(title="semi-axes", ylabel="[m]")
    else:
        # Of low waves, this moment and the elevation at x = 0 are in proportion.
        moment = moment_of(run)
        scale = (moment - moment.mean()) / np.ptp(moment)
        friction = 2.0 * run.viscosity * WAVE_NUMBER**2
        linear = -np.exp(-friction * fine) * np.sin(OMEGA * fine)  # it falls first at x = 0
        sampled = np.interp(time, fine, linear)
        axes.plot(fine, linear / np.ptp(sampled), **known, label="linear theory")
        axes.plot(time, scale, color=COLOURS[0], label="full model")
        axes.set(title="amplitude of the wave", ylabel="over its range")
    axes.legend(fontsize=7.5, loc="upper right")


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="+", choices=(*PARTS, "pictures"))
    parser.add_argument("--resolution", type=int, nargs="+", help="particles over a length of one")
    parser.add_argument("--ratio", type=float, nargs="+", default=[None], help="h / dx")
    parser.add_argument("--set", nargs="+", default=[], help="keys of all cases, as KEY=VALUE")
    parser.add_argument("--periods", type=float, default=20.0, help="of fluid at rest")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/free_surface"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "free_surface.json"
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for part in given.parts:
        if part == "pictures":
            draw(Runs(given.out, given.threads, {}))
            continue
        measure, resolutions = PARTS[part]
        if part == "rest":
            measure = partial(rest, periods=given.periods)
        for resolution, ratio in product(given.resolution or resolutions, given.ratio):
            keys = {
                key: yaml.safe_load(value)
                for key, _, value in (x.partition("=") for x in given.set)
            }
            if ratio is not None:
                keys["discretization.smoothing_length_ratio"] = ratio
            found = measure(Runs(given.out, given.threads, keys), resolution)
            told = ", ".join(f"{key}: {value}" for key, value in keys.items())
            where = f"{part}, resolution {resolution}{told and ', '}{told}"
            rows[where] = found
            print(where, *(f"  {name:46}{value:12.5g}" for name, value in found.items()), sep="\n")
            path.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
