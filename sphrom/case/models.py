"""The case file as frozen pydantic models: every key with its default, unit and description.

A model checks each value by itself; what must hold between keys is in `sphrom.case.checks`. Use
`sphrom.case.loader.load_case` to have both.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from sphrom.case.fields import Duration, Flag, Number, Positive, SafeName, Whole, key
from sphrom.case.points import ParameterPoint

ALL = "all"
"""The name of the basis that is trained on every training value."""
MLS_SMOOTHING_LENGTH_RATIO = 2.0
"""Smoothing length of moving least squares over the spacing: they need no wider support."""
MODES_WITHOUT_ROM = 10
"""Modes to keep when no reduced model asks for any."""


class Section(BaseModel):
    """What all sections share: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class TaylorGreenScene(Section):
    """The Taylor-Green vortex in a periodic square (Eq. 4.4)."""

    kind: Literal["taylor-green"] = key(..., "which flow")
    length: Positive = key(1.0, "side of the periodic square", unit="m")
    pressure_sign: Literal["exact", "paper"] = key(
        "exact", "sign of the initial pressure: exact, or as printed in Eq. 4.4"
    )


class FluidSection(Section):
    """The fluid, and the scales that make it weakly compressible."""

    reference_density: Positive = key(1000.0, "density at zero pressure", unit="kg/m3")
    reference_speed: Positive = key(1.0, "largest speed of the flow, U_max", unit="m/s")
    mach_number: Number = key(
        0.1,
        "U_max over the speed of sound, which it decides; up to 0.3 a flow is weakly compressible",
        unit="-",
        ge=1e-3,
        le=0.3,
    )


class PackingSection(Section):
    """How particles are packed before the run."""

    seed: Whole = key(0, "seed of the random start", ge=0, le=2**32 - 1)
    perturbation: Number = key(
        0.5, "how far the start leaves a lattice, over the spacing", unit="-", ge=0.0, le=1.0
    )
    tolerance: Number = key(1e-3, "unevenness at which packing is done", unit="-", ge=1e-12, le=1.0)
    max_iterations: Whole = key(
        2000, "iterations after which packing stops, with a warning", ge=1, le=1_000_000
    )


class ShiftingSection(Section):
    """Particle shifting inside the equations (Eq. 2.13-2.14)."""

    enabled: Flag = key(True, "whether particles are shifted at all")
    amplitude: Number = key(0.2, "chi of Eq. 2.14", unit="-", ge=0.0, le=10.0)
    form: Literal["sun", "paper"] = key(
        "sun", "the bracket of Eq. 2.14, with xi = 4: after Sun et al. 2017, or as printed"
    )


class DiscretizationSection(Section):
    """How the fluid is cut into particles."""

    resolution: Whole = key(100, "particles along the scene's length", ge=8, le=100_000)
    smoothing_length_ratio: Number = key(
        4.0, "smoothing length over particle spacing, h/dx", unit="-", ge=1.2, le=8.0
    )
    diffusion_coefficient: Number = key(
        0.1, "delta of the density diffusion (Eq. 2.6)", unit="-", ge=0.0, le=1.0
    )
    viscosity: Literal["laplacian", "paper"] = key(
        "laplacian", "viscous operator: the velocity's Laplacian, or Eq. 2.12 as printed"
    )
    initial_particles: Literal["packed", "lattice"] = key(
        "packed", "where particles start; a lattice breaks up noisily"
    )
    packing: PackingSection = key(PackingSection(), "how particles are packed before the run")
    shifting: ShiftingSection = key(ShiftingSection(), "particle shifting (Eq. 2.13-2.14)")


class TimeSection(Section):
    """How long, and in which steps, the full model runs."""

    final_time: Positive = key(1.0, "time at which every run ends", unit="s")
    step: Positive | Literal["auto"] = key(
        "auto", "time step; auto takes it from the Courant number and the viscous limit", unit="s"
    )
    courant_number: Number = key(
        0.75, "c0 dt / h of the automatic step (Eq. 2.19)", unit="-", ge=1e-6, le=1.5
    )


class SnapshotSection(Section):
    """Which instants are kept."""

    every: Whole = key(10, "steps from one snapshot to the next", ge=1, le=1_000_000_000)


ReynoldsValues = Annotated[tuple[Positive, ...], Field(min_length=1)]


class TrainValues(Section):
    """Where the full model is run to learn from."""

    reynolds: ReynoldsValues = key((100.0,), "Reynolds numbers U_max L / nu", unit="-")


class TestValues(Section):
    """Where the full model is run only to check predictions."""

    __test__ = False  # pytest would take it for a test

    reynolds: tuple[Positive, ...] = key((), "Reynolds numbers U_max L / nu", unit="-")


class ParameterSection(Section):
    """The values of the parameters to learn from and to predict."""

    train: TrainValues = key(TrainValues(), "values to learn from")
    test: TestValues = key(TestValues(), "values to predict, with a full run to compare with")


class ReferenceSection(Section):
    """The reference space that snapshots are mapped onto (Eq. 3.13-3.15)."""

    points: Literal["initial", "relaxed", "lattice"] = key("initial", "where its points are")
    method: Literal["mls", "shepard"] = key(
        "mls", "second-order moving least squares, or the Shepard filter of Eq. 3.15"
    )
    smoothing_length_ratio: Annotated[Number, Field(ge=1.2, le=8.0)] | None = key(
        None,
        "smoothing length of the map over the spacing; null is 2 for mls, "
        "and the discretization's for shepard",
        unit="-",
    )


class SubsetSection(Section):
    """A basis that learns from some of the training values only."""

    reynolds: ReynoldsValues = key(..., "those of the training values it learns from", unit="-")


class BasisSection(Section):
    """The trial basis (Eq. 3.16)."""

    n_modes: Annotated[Whole, Field(ge=1, le=10_000)] | None = key(
        None, "modes to keep; null keeps what the reduced models ask for"
    )
    inner_product: Literal["acoustic", "raw"] = key(
        "acoustic", "acoustic energy, in which the reduced model is stable, or raw stacked values"
    )
    centred: Flag = key(False, "whether the mean snapshot is subtracted first")
    fields: Literal["joint", "separate"] = key(
        "joint", "one basis for density and velocity, or one each"
    )
    lagrangian: Flag = key(False, "whether singular values of unmapped snapshots are kept too")
    subsets: dict[SafeName, SubsetSection] = key(
        {}, "further bases by name, each from some training values; `all` is always there"
    )


class SplineSection(Section):
    """Local polyharmonic splines of the modes (Eq. 3.17-3.20)."""

    order: Whole = key(3, "k of Eq. 3.18", ge=1, le=7)
    polynomial_degree: Whole = key(1, "degree of the polynomial part", ge=0, le=3)
    cell_width_ratio: Annotated[Number, Field(ge=1.0, le=16.0)] | None = key(
        None, "width of a cell over the particle spacing; null chooses", unit="-"
    )


class ReducedModelSection(Section):
    """One reduced model (Alg. 3.4 and 3.5)."""

    name: SafeName = key(..., "what its files and tables call it")
    frame: Literal["particles"] = key(
        "particles", "where its right-hand side is evaluated: on the moving particles"
    )
    projection: Literal["galerkin", "apg"] = key(
        "galerkin", "Galerkin (Alg. 3.4) or adjoint Petrov-Galerkin (Alg. 3.5)"
    )
    n_modes: Whole = key(5, "modes it uses", ge=1, le=10_000)
    basis: SafeName = key(ALL, "which basis: all, or one of basis.subsets")
    advection: Literal["consistent", "paper"] = key(
        "consistent", "whether shifting advects the modes too, or as in Eq. 3.5-3.6"
    )
    memory_length: Duration | Literal["auto"] = key(
        "auto", "tau of Eq. 3.22, for projection: apg", unit="s"
    )
    jacobian_step: Number = key(
        1e-5,
        "epsilon of Eq. 3.22 over the state's norm, for projection: apg",
        unit="-",
        ge=1e-12,
        le=1.0,
    )
    time_step: Positive | Literal["fom"] = key(
        "fom", "its time step; fom takes the full model's", unit="s"
    )
    parameters: Literal["all", "train", "test"] | ReynoldsValues = key(
        "all", "which of the case's values it is run at", unit="-"
    )


class CompareSection(Section):
    """How reduced and full runs are compared (Eq. 4.1-4.3)."""

    line_points: Whole = key(101, "points along a centreline", ge=2, le=100_000)
    grid: Whole = key(50, "points along each side for whole fields", ge=2, le=2_000)
    exact: Flag = key(True, "whether to compare with the exact solution where there is one")
    plots: Flag = key(True, "whether to draw figures")
    from_time: Duration = key(0.0, "time before which errors are left out", unit="s")


class Case(Section):
    """A case of sphrom: one flow, its full runs, and the reduced models made from them."""

    name: SafeName = key(..., "what its folder under runs/ is called")
    scene: TaylorGreenScene = key(..., "geometry with initial and boundary conditions")
    fluid: FluidSection = key(FluidSection(), "the fluid")
    discretization: DiscretizationSection = key(
        DiscretizationSection(), "how the fluid is cut into particles"
    )
    time: TimeSection = key(TimeSection(), "how long, and in which steps, the full model runs")
    snapshots: SnapshotSection = key(SnapshotSection(), "which instants are kept")
    parameters: ParameterSection = key(
        ParameterSection(), "values of the parameters to learn from and to predict"
    )
    reference: ReferenceSection = key(
        ReferenceSection(), "points that snapshots are mapped onto (Eq. 3.13-3.15)"
    )
    basis: BasisSection = key(BasisSection(), "the trial basis (Eq. 3.16)")
    psi: SplineSection = key(
        SplineSection(), "local polyharmonic splines of the modes (Eq. 3.17-3.20)"
    )
    rom: tuple[ReducedModelSection, ...] = key(
        (ReducedModelSection(name="galerkin"),), "reduced models to run and compare"
    )
    compare: CompareSection = key(
        CompareSection(), "how reduced and full runs are compared (Eq. 4.1-4.3)"
    )

    @property
    def particle_spacing(self) -> float:
        """dx [m]."""
        return self.scene.length / self.discretization.resolution

    @property
    def smoothing_length(self) -> float:
        """h [m]."""
        return self.discretization.smoothing_length_ratio * self.particle_spacing

    @property
    def reference_smoothing_length(self) -> float:
        """h of the map onto the reference space [m]."""
        ratio = self.reference.smoothing_length_ratio
        if ratio is not None:
            return ratio * self.particle_spacing
        if self.reference.method == "mls":
            return MLS_SMOOTHING_LENGTH_RATIO * self.particle_spacing
        return self.smoothing_length

    @property
    def sound_speed(self) -> float:
        """c0 [m/s]."""
        return self.fluid.reference_speed / self.fluid.mach_number

    def kinematic_viscosity(self, point: ParameterPoint) -> float:
        """nu [m2/s] at a parameter point."""
        return self.fluid.reference_speed * self.scene.length / point.reynolds

    @property
    def train_points(self) -> tuple[ParameterPoint, ...]:
        """Where the full model is run to learn from."""
        return tuple(map(ParameterPoint, self.parameters.train.reynolds))

    @property
    def test_points(self) -> tuple[ParameterPoint, ...]:
        """Where the full model is run only to check predictions."""
        return tuple(map(ParameterPoint, self.parameters.test.reynolds))

    @property
    def points(self) -> tuple[ParameterPoint, ...]:
        """Every point at which the full model is run."""
        return self.train_points + self.test_points

    @property
    def bases(self) -> dict[str, tuple[ParameterPoint, ...]]:
        """The points that each basis learns from, by the basis' name."""
        subsets = {
            name: tuple(map(ParameterPoint, subset.reynolds))
            for name, subset in self.basis.subsets.items()
        }
        return {ALL: self.train_points, **subsets}

    @property
    def n_modes(self) -> int:
        """Modes to keep of each basis, as far as its snapshots allow."""
        asked = max((model.n_modes for model in self.rom), default=MODES_WITHOUT_ROM)
        return self.basis.n_modes or asked

    def rom_points(self, model: ReducedModelSection) -> tuple[ParameterPoint, ...]:
        """Return the points at which a reduced model is run."""
        named = {"all": self.points, "train": self.train_points, "test": self.test_points}
        if isinstance(model.parameters, str):
            return named[model.parameters]
        return tuple(map(ParameterPoint, model.parameters))
