"""The table of artifact schemas: it drives writing, checking and documentation.

A schema lists the datasets and attributes of one kind of artifact. In a name, `*` stands for one
group that the writer names, such as a basis or a parameter. Axes are named: within one artifact an
axis has one length, and within a `*` group its own axes have theirs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

# Another major version is refused; a newer minor version only adds.
SCHEMA_VERSION = "1.0"


@dataclass(frozen=True)
class DatasetField:
    """One dataset of a schema: what it holds, along which axes, in which units."""

    name: str
    axes: tuple[str, ...]
    units: str
    symbol: str
    equation: str
    meaning: str
    required: bool = True
    dtype: str = "float64"

    @property
    def per_snapshot(self) -> bool:
        """Whether each entry of the first axis is a whole field, and so a chunk of its own."""
        return self.axes[:1] in (("snapshot",), ("mode",)) and "particle" in self.axes

    @property
    def rises(self) -> bool:
        """Whether it counts the times or steps of snapshots, each above the one before."""
        return self.axes == ("snapshot",) and self.symbol in ("t", "n")

    @property
    def is_place(self) -> bool:
        """Whether it holds positions in the domain."""
        return self.units == "m" and self.axes[-1:] == ("component",)


@dataclass(frozen=True)
class AttributeField:
    """One attribute of a schema: `kind` is `float`, `floats` (a vector), `int` or `text`."""

    name: str
    kind: str
    units: str
    meaning: str
    required: bool = True
    allowed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Schema:
    """One kind of artifact: its datasets, attributes, and groups of which there is at least one."""

    name: str
    meaning: str
    datasets: tuple[DatasetField, ...]
    attributes: tuple[AttributeField, ...] = ()
    at_least_one: tuple[str, ...] = ()


# Written at the root of every artifact by the writer itself; no part of the content's digest.
PROVENANCE = (
    AttributeField("schema", "text", "", "kind of artifact"),
    AttributeField("schema_version", "text", "", "version of the kind; another major is refused"),
    AttributeField("stage", "text", "", "command that wrote the artifact"),
    AttributeField("uuid", "text", "", "identity of this very file"),
    AttributeField("software", "text", "", "program that wrote the artifact"),
    AttributeField("softwareVersion", "text", "", "its version"),
    AttributeField("date", "text", "", "when writing began, UTC"),
    AttributeField("machine", "text", "", "number of cores of the machine"),
    AttributeField("case_sha256", "text", "", "digest of the resolved case"),
    AttributeField("inputs_sha256", "text", "", "digest of the part of the case that matters here"),
    AttributeField("wall_seconds", "float", "s", "time from opening to closing the artifact"),
    AttributeField("threads", "int", "", "threads that the stage used"),
    AttributeField("content_sha256", "text", "", "digest of the datasets and attributes"),
)

# Wall-clock of the parts of a stage; no part of the content's digest.
TIMING = AttributeField("timing/*", "float", "s", "time spent in a part of the stage", False)

_REFERENCE_POSITION = DatasetField(
    "reference_position",
    ("particle", "component"),
    "m",
    "x_G",
    "Eq. 3.14",
    "points of the reference space",
)
_TIME = DatasetField("time", ("snapshot",), "s", "t", "Eq. 2.18", "time of each snapshot")
_DENSITY_FLUCTUATION = DatasetField(
    "density_fluctuation",
    ("snapshot", "particle"),
    "kg/m3",
    "rho - rho_0",
    "Eq. 2.6",
    "density less its reference value",
)
_VELOCITY = DatasetField(
    "velocity", ("snapshot", "particle", "component"), "m/s", "u", "Eq. 2.7", "velocity"
)
_STATE_UNIT = "of the inner product's state"
_PARAMETERS = AttributeField("parameters/*", "float", "", "parameter values of the run", False)
_REFERENCE_DENSITY = AttributeField("reference_density", "float", "kg/m3", "rho_0 of Eq. 2.8")
_SOUND_SPEED = AttributeField("sound_speed", "float", "m/s", "c_0 of Eq. 2.8")

_RUN = (
    _PARAMETERS,
    _REFERENCE_DENSITY,
    _SOUND_SPEED,
    AttributeField("kinematic_viscosity", "float", "m2/s", "nu of Eq. 2.12"),
    AttributeField("particle_spacing", "float", "m", "initial spacing of the particles"),
    AttributeField("smoothing_length", "float", "m", "h of Eq. 2.2"),
    AttributeField("time_step", "float", "s", "step of Eq. 2.18"),
    AttributeField("mass", "float", "kg/m", "mass of a particle, per metre of depth"),
    AttributeField("box_length", "floats", "m", "edges of the box"),
)

PACKING = Schema(
    "sphrom/packing",
    "starting positions, packed",
    (
        DatasetField(
            "position", ("particle", "component"), "m", "x", "Eq. 2.8", "packed positions"
        ),
        DatasetField(
            "residual", ("iteration",), "1", "", "", "residual of packing at each iteration"
        ),
    ),
    (
        AttributeField("particle_spacing", "float", "m", "spacing of the particles"),
        AttributeField("smoothing_length", "float", "m", "smoothing length that packing used"),
        AttributeField("box_length", "floats", "m", "edges of the box"),
    ),
)

STATE = Schema(
    "sphrom/state",
    "the state of a full run at the end of its spin-up",
    (
        DatasetField(
            "position", ("particle", "component"), "m", "x", "Eq. 2.8", "positions of particles"
        ),
        DatasetField(
            "density_fluctuation",
            ("particle",),
            "kg/m3",
            "rho - rho_0",
            "Eq. 2.6",
            "density less its reference value",
        ),
        DatasetField("velocity", ("particle", "component"), "m/s", "u", "Eq. 2.7", "velocity"),
    ),
    (
        *_RUN,
        AttributeField("time", "float", "s", "time of the state"),
        TIMING,
    ),
)

TRAJECTORY = Schema(
    "sphrom/trajectory",
    "the time series of a full or reduced run",
    (
        _TIME,
        DatasetField(
            "step",
            ("snapshot",),
            "1",
            "n",
            "Eq. 2.18",
            "steps taken up to each snapshot, without those of a spin-up",
            dtype="int64",
        ),
        DatasetField(
            "position",
            ("snapshot", "particle", "component"),
            "m",
            "x",
            "Eq. 2.8",
            "particle positions",
        ),
        _VELOCITY,
        _DENSITY_FLUCTUATION,
        DatasetField("pressure", ("snapshot", "particle"), "Pa", "p", "Eq. 2.8", "pressure"),
        DatasetField(
            "generalized_coordinates",
            ("snapshot", "mode"),
            "of the inner product",
            "omega-hat",
            "Eq. 3.11",
            "coordinates of a reduced run in its basis",
            required=False,
        ),
        DatasetField(
            "mean_density_fluctuation",
            ("snapshot",),
            "kg/m3",
            "",
            "",
            "mean that a reduced run carries apart from its modes, in closed boxes",
            required=False,
        ),
        DatasetField(
            "ghost/position",
            ("ghost", "component"),
            "m",
            "x",
            "Eq. 2.15",
            "ghost particles of walls",
            required=False,
        ),
        DatasetField(
            "ghost/wall_velocity",
            ("ghost", "component"),
            "m/s",
            "U_wall",
            "Eq. 2.15",
            "velocity of the wall that each ghost belongs to, once it is up to speed",
            required=False,
        ),
    ),
    (
        AttributeField("status", "text", "", "how the run ended", allowed=("complete", "unstable")),
        AttributeField("status_detail", "text", "", "what went wrong, where and when", False),
        *_RUN,
        AttributeField("memory_length", "float", "s", "tau of Eq. 3.22, of a reduced run", False),
        AttributeField("imported/files", "text", "", "another program's, that it is from", False),
        AttributeField("imported/sha256", "text", "", "digest of those files", False),
    ),
)

REFERENCE_SNAPSHOTS = Schema(
    "sphrom/reference-snapshots",
    "the snapshots of one run, mapped onto the reference space",
    (_REFERENCE_POSITION, _TIME, _DENSITY_FLUCTUATION, _VELOCITY),
    (
        _PARAMETERS,
        _REFERENCE_DENSITY,
        _SOUND_SPEED,
        AttributeField(
            "map_error/*",
            "float",
            "%",
            "relative L2 error of the map on the exact solution, by field",
            False,
        ),
        AttributeField(
            "round_trip_error/*",
            "float",
            "%",
            "what the last snapshot loses by the map and back, over the whole field's root mean "
            "square, by field and part of the fluid, where no exact solution is known",
            False,
        ),
    ),
)

BASIS = Schema(
    "sphrom/basis",
    "trial bases and their singular values",
    (
        _REFERENCE_POSITION,
        DatasetField(
            "volume", ("particle",), "m2", "V", "Eq. 3.15", "area that each point stands for"
        ),
        DatasetField(
            "mean_density_fluctuation/*",
            ("snapshot",),
            "kg/m3",
            "",
            "",
            "spatial mean of each snapshot of a training run, taken out before the decomposition "
            "where it is carried apart",
            required=False,
        ),
        DatasetField(
            "bases/*/modes/density",
            ("mode", "particle"),
            _STATE_UNIT,
            "Phi",
            "Eq. 3.16",
            "density part of the modes",
        ),
        DatasetField(
            "bases/*/modes/velocity",
            ("mode", "particle", "component"),
            _STATE_UNIT,
            "Phi",
            "Eq. 3.16",
            "velocity part of the modes",
        ),
        DatasetField(
            "bases/*/offset/density",
            ("particle",),
            _STATE_UNIT,
            "",
            "",
            "mean of the state's first field, taken out before the decomposition",
            required=False,
        ),
        DatasetField(
            "bases/*/offset/velocity",
            ("particle", "component"),
            "m/s",
            "",
            "",
            "mean velocity that was taken out before the decomposition",
            required=False,
        ),
        DatasetField(
            "bases/*/singular_values/*",
            ("singular_value",),
            "of the inner product",
            "sigma",
            "Eq. 3.16",
            "singular values, descending, by part",
            required=False,
        ),
        DatasetField(
            "bases/*/train",
            ("training_run", "parameter"),
            "of the parameters",
            "mu",
            "Eq. 2.17",
            "parameter values of the training runs",
        ),
        DatasetField(
            "lagrangian/*/singular_values/*",
            ("singular_value",),
            "of the inner product",
            "sigma",
            "Eq. 3.13",
            "singular values of the snapshots on the moving particles",
            required=False,
        ),
        DatasetField(
            "lagrangian/*/modes/density",
            ("mode", "particle"),
            _STATE_UNIT,
            "Phi",
            "Eq. 3.16",
            "density part of the modes of the snapshots on the moving particles",
            required=False,
        ),
        DatasetField(
            "lagrangian/*/modes/velocity",
            ("mode", "particle", "component"),
            _STATE_UNIT,
            "Phi",
            "Eq. 3.16",
            "velocity part of the modes of the snapshots on the moving particles",
            required=False,
        ),
        DatasetField(
            "lagrangian_position",
            ("particle", "component"),
            "m",
            "x",
            "Eq. 3.13",
            "where the particles of the Lagrangian modes started",
            required=False,
        ),
    ),
    (
        AttributeField("inner_product", "text", "", "inner product of the modes"),
        _REFERENCE_DENSITY,
        _SOUND_SPEED,
        AttributeField("bases/*/gram_error", "float", "1", "largest departure from orthonormality"),
    ),
    at_least_one=("bases/*",),
)

SPLINE = Schema(
    "sphrom/spline",
    "local polyharmonic splines of the modes, by cell",
    (
        DatasetField(
            "bases/*/cell_shape",
            ("component",),
            "1",
            "",
            "Alg. 3.2",
            "number of cells along each direction",
            dtype="int64",
        ),
        DatasetField(
            "bases/*/cell_start",
            ("cell_boundary",),
            "1",
            "",
            "Alg. 3.3",
            "first point of each cell's system, and one past the last",
            dtype="int64",
        ),
        DatasetField(
            "bases/*/points",
            ("component", "point"),
            "cell widths",
            "x_G",
            "Eq. 3.17",
            "points of each cell's system, from the cell's centre",
        ),
        DatasetField(
            "bases/*/radial_weights",
            ("column", "point"),
            "of the modes",
            "xi",
            "Eq. 3.19",
            "weights of the radial functions, a column for each mode and field",
        ),
        DatasetField(
            "bases/*/polynomial_weights",
            ("cell", "term", "column"),
            "of the modes",
            "eta",
            "Eq. 3.19",
            "weights of the polynomial",
        ),
        DatasetField(
            "bases/*/condition_number",
            ("cell",),
            "1",
            "",
            "Eq. 3.19",
            "condition number of each cell's system; zero where a cell in the solid has none",
        ),
    ),
    (
        AttributeField("spline_order", "int", "1", "k of Eq. 3.18"),
        AttributeField("polynomial_degree", "int", "1", "degree of the polynomial of Eq. 3.17"),
    ),
    at_least_one=("bases/*",),
)

B_SPLINE = Schema(
    "sphrom/b-spline",
    "tensor-product cubic B-splines of the modes, on a lattice",
    (
        DatasetField(
            "bases/*/lattice_shape",
            ("component",),
            "1",
            "",
            "",
            "number of reference points along each direction",
            dtype="int64",
        ),
        DatasetField(
            "bases/*/coefficients",
            ("node_row", "node", "column"),
            "of the modes",
            "",
            "Eq. 3.20",
            "what the B-splines around each point are multiplied with, for each mode and field",
        ),
    ),
    at_least_one=("bases/*",),
)


def _series(name: str, equation: str, meaning: str) -> DatasetField:
    return DatasetField(
        f"series/*/*/{name}", ("snapshot",), "%", "", equation, meaning, required=False
    )


def _samples(group: str, places: str, where: str) -> tuple[DatasetField, ...]:
    """Describe what was sampled at some places over time."""
    one = f"{group}/*/*"
    return (
        DatasetField(f"{one}/position", ("point", "component"), "m", "x", "", places, False),
        DatasetField(
            f"{one}/time", ("snapshot",), "s", "t", "Eq. 2.18", "time of each snapshot", False
        ),
        DatasetField(
            f"{one}/velocity",
            ("snapshot", "point", "component"),
            "m/s",
            "u",
            "",
            f"velocity {where}",
            False,
        ),
        DatasetField(
            f"{one}/pressure", ("snapshot", "point"), "Pa", "p", "", f"pressure {where}", False
        ),
    )


def _tensors(part: str, degrees: int, required: bool, meaning: str) -> tuple[DatasetField, ...]:
    """Return the tensors of one part of the operators, up to a degree."""
    names = ("constant", "linear", "quadratic")
    return tuple(
        DatasetField(
            f"bases/*/{part}/{names[degree]}",
            ("mode",) * (degree + 1),
            f"of the modes, /s{meaning}",
            "c A H"[2 * degree],
            "Eq. 3.21",
            f"{names[degree]} part of the reduced rates by {part}",
            required=required,
        )
        for degree in range(degrees + 1)
    )


_OF_FIELDS = ", of velocity and of c0 rho'/rho0 less its mean"


def _memory(group: str, highest: int, required: bool, meaning: str) -> tuple[DatasetField, ...]:
    """Return the tensors of the closure by the viscosity's power, up to a degree."""
    return tuple(
        DatasetField(
            f"bases/*/memory/*/{group}{name}",
            ("viscosity_power", *("mode",) * (degree + 1)),
            f"of the modes, /s2{meaning}",
            "",
            "Eq. 3.22",
            f"{name} part of what a closure with so many modes adds, per memory length, by the "
            "power of the viscosity [m2/s]",
            required=required,
        )
        for degree, name in enumerate(("constant", "linear", "quadratic", "cubic")[: highest + 1])
    )


_RESIDUAL = (
    *(
        DatasetField(
            f"bases/*/residual/{part}",
            ("direction", "monomial" if part in ("inertia", "viscosity") else "linear_monomial"),
            f"of the inner product, /s{meaning}",
            "",
            "",
            f"what projection leaves out of the rates by {part}: times monomials of coordinates, a "
            "vector with the residual's norm",
            required=False,
        )
        for part, meaning in (
            ("inertia", ""),
            ("viscosity", " per m2/s of viscosity"),
            ("walls", " per m2/s of viscosity, at the walls' speed"),
            ("force", " per amplitude of the body force"),
        )
    ),
    *(
        DatasetField(
            f"bases/*/estimate/unheld/{name}",
            axes,
            "m/s over the inner product's",
            "",
            "",
            f"root mean square error of the best approximation over the change {meaning}, of "
            "training snapshots left out of a basis of 1, 2, ... modes; of the velocity, then of "
            "c0 rho'/rho0 less its mean",
            required=False,
        )
        for name, axes, meaning in (
            ("parameters", ("size", "field"), "from the other training runs"),
            ("time", ("run", "size", "field"), "since half time"),
        )
    ),
    *(
        DatasetField(
            f"bases/*/estimate/{name}", axes, units, "", "", f"{meaning}{fields}", required=False
        )
        for name, axes, units, meaning, fields in (
            (
                "start",
                ("training_run", "mode"),
                "of the inner product",
                "coordinates at the start of each training run",
                "",
            ),
            (
                "gram",
                ("field", "column", "column"),
                "of the modes",
                "mean products of modes, and of what is constant in states, with each other",
                _OF_FIELDS,
            ),
            (
                "projections",
                ("training_run", "compared_snapshot", "field", "column"),
                "of the modes",
                "mean products of some training snapshots with them",
                _OF_FIELDS,
            ),
            (
                "squares",
                ("training_run", "compared_snapshot", "field"),
                "m2/s2",
                "mean squares of those snapshots",
                _OF_FIELDS,
            ),
        )
    ),
)

OPERATORS = Schema(
    "sphrom/operators",
    "right-hand side on the reference points, projected onto each basis",
    (
        *_tensors("inertia", 2, True, ""),
        *_tensors("viscosity", 2, True, " per m2/s of viscosity"),
        *_tensors("walls", 1, False, " per m2/s of viscosity, at the walls' speed"),
        *_tensors("force", 1, False, " per amplitude of the body force"),
        DatasetField(
            "bases/*/acoustic",
            ("mode", "mode"),
            "of the modes, /s",
            "",
            "Eq. 3.21",
            "what pressure and divergence alone are of the linear part",
        ),
        DatasetField(
            "bases/*/states",
            ("state", "mode"),
            "of the inner product",
            "omega-hat",
            "Eq. 3.11",
            "coordinates of some training snapshots, around which steps have to be stable",
        ),
        DatasetField(
            "bases/*/training_runs",
            ("run", "snapshot", "mode"),
            "of the inner product",
            "omega-hat",
            "Eq. 3.11",
            "coordinates of all snapshots that the basis learnt from, to calibrate with",
            required=False,
        ),
        *_RESIDUAL,
        *_memory("", 3, True, ""),
        *_memory("force/", 2, False, " per amplitude of the body force"),
        *_memory("force_squared/", 1, False, " per squared amplitude of the body force"),
    ),
    (
        AttributeField("density_order", "int", "", "to which 1/rho is expanded"),
        AttributeField(
            "walls_driven", "int", "", "1 where the amplitude is that of the walls' speed, else 0"
        ),
        AttributeField("bases/*/skewness", "float", "1", "of the acoustic part; zero is skew"),
        AttributeField(
            "bases/*/expansion_error", "float", "1", "largest that expanding 1/rho makes in rates"
        ),
        TIMING,
    ),
    at_least_one=("bases/*",),
)

COORDINATES = Schema(
    "sphrom/coordinates",
    "the time series of a reduced run on the reference points",
    (
        _TIME,
        DatasetField(
            "generalized_coordinates",
            ("snapshot", "mode"),
            "of the inner product",
            "omega-hat",
            "Eq. 3.11",
            "coordinates in the basis",
        ),
        DatasetField(
            "residual",
            ("snapshot",),
            "of the inner product, /s",
            "",
            "",
            "norm of what the model leaves out of the rates",
            required=False,
        ),
        *(
            DatasetField(
                f"error_estimate/{field}",
                ("snapshot",),
                units,
                "",
                "",
                f"estimated root mean square error of the {meaning}",
                required=False,
            )
            for field, units, meaning in (
                ("velocity", "m/s", "velocity"),
                ("pressure", "Pa", "pressure less its mean"),
            )
        ),
        DatasetField(
            "error_estimate/change",
            ("snapshot", "cause"),
            "of the inner product",
            "",
            "",
            "how far coordinates are from what training runs make of them: by the parameters, and "
            "since the training runs ended",
            required=False,
        ),
        DatasetField(
            "steady/coordinates",
            ("mode",),
            "of the inner product",
            "omega-hat",
            "Eq. 3.11",
            "where the rates vanish, or the nearest that was found, from where the run ended",
            required=False,
        ),
        DatasetField(
            "reference_position",
            ("particle", "component"),
            "m",
            "x_G",
            "Eq. 3.14",
            "points of the reference space, where fields are kept",
            required=False,
        ),
        DatasetField(
            "samples",
            ("sample",),
            "1",
            "",
            "",
            "points of the reference space at which rates are sampled, counted from zero",
            required=False,
            dtype="int64",
        ),
        DatasetField(
            "position",
            ("snapshot", "tracer", "component"),
            "m",
            "x",
            "Eq. 3.23",
            "particles that are carried along, where they are asked for",
            required=False,
        ),
        replace(_DENSITY_FLUCTUATION, required=False),
        replace(_VELOCITY, required=False),
        DatasetField(
            "pressure", ("snapshot", "particle"), "Pa", "p", "Eq. 2.8", "pressure", required=False
        ),
        *(
            DatasetField(f"probes/{name}", axes, units, symbol, equation, meaning, required=False)
            for name, axes, units, symbol, equation, meaning in (
                (
                    "position",
                    ("probe", "component"),
                    "m",
                    "x",
                    "",
                    "where runs are compared: the line's points, the grid's, then the stations",
                ),
                (
                    "velocity",
                    ("snapshot", "probe", "component"),
                    "m/s",
                    "u",
                    "Eq. 2.7",
                    "velocity there",
                ),
                ("pressure", ("snapshot", "probe"), "Pa", "p", "Eq. 2.8", "pressure there"),
            )
        ),
    ),
    (
        AttributeField("status", "text", "", "how the run ended", allowed=("complete", "unstable")),
        AttributeField("status_detail", "text", "", "what went wrong, and when", False),
        *_RUN,
        AttributeField("memory_length", "float", "s", "tau of Eq. 3.22", False),
        AttributeField(
            "sampling_error",
            "float",
            "1",
            "of sampled rates between training states, over those of all points",
            False,
        ),
        AttributeField("mean_density_fluctuation", "float", "kg/m3", "carried apart, constant"),
        AttributeField(
            "integrator",
            "text",
            "",
            "what steps are: Runge-Kutta's (Eq. 2.18), or exponential, the linear part exact",
            False,
            allowed=("runge-kutta", "exponential"),
        ),
        AttributeField(
            "step_limit",
            "float",
            "s",
            "largest stable Runge-Kutta step; absent where any is",
            False,
        ),
        AttributeField("largest_real_part", "float", "1/s", "of the spectrum at the start"),
        AttributeField(
            "error_estimate/decay_rate", "float", "1/s", "at which errors are forgotten", False
        ),
        AttributeField(
            "error_estimate/training",
            "text",
            "",
            "whether the run is inside or outside of the trained parameters and times; outside "
            "the estimate is extrapolated",
            False,
            ("inside", "outside"),
        ),
        *(
            field
            for name, units in (("velocity", "m/s"), ("pressure", "Pa"))
            for field in (
                AttributeField(
                    f"error_estimate/{name}_constant",
                    "float",
                    f"{units} over the inner product's",
                    "error over the residual's integral that decays, in training",
                    False,
                ),
                AttributeField(
                    f"error_estimate/{name}_factor",
                    "float",
                    "1",
                    "that 95 % of the training errors are within, either way, of estimates with "
                    "the other training runs' constant; absent outside of training",
                    False,
                ),
            )
        ),
        AttributeField(
            "steady/status",
            "text",
            "",
            "whether a steady state was found",
            False,
            ("converged", "not converged"),
        ),
        AttributeField("steady/residual", "float", "of the modes, /s", "norm of its rates", False),
        AttributeField(
            "steady/training_distance",
            "float",
            "1",
            "from the nearest of some training states, over the norm of the steady state",
            False,
        ),
        AttributeField(
            "steady/residual_left_out",
            "float",
            "of the inner product, /s",
            "norm of what the basis leaves out of the rates there",
            False,
        ),
        *(
            AttributeField(
                f"steady/{name}_error_estimate",
                "float",
                units,
                f"estimated root mean square error of the {name}",
                False,
            )
            for name, units in (("velocity", "m/s"), ("pressure", "Pa"))
        ),
        AttributeField("steady/n_steps", "int", "", "steps of Newton's method", False),
        AttributeField("steady/largest_real_part", "float", "1/s", "of the spectrum there", False),
        TIMING,
    ),
)

COMPARED_AT = (("line", "on the line"), ("field", "over the whole field"))
"""Where runs are compared, and how that is said."""

COMPARISON = Schema(
    "sphrom/comparison",
    "figures of merit over time, by what is compared and by parameter",
    (
        DatasetField(
            "series/*/*/time", ("snapshot",), "s", "t", "Eq. 2.18", "time of each snapshot"
        ),
        *(
            _series(f"{quantity}_{place}_relative_l2", "", f"relative L2 error of {norm}, {where}")
            for quantity, norm in (
                ("velocity", "velocity"),
                ("pressure", "pressure less its mean there"),
            )
            for place, where in COMPARED_AT
        ),
        *(
            _series(
                f"{quantity}_{place}_eq41_by_{over}_range",
                "Eq. 4.1",
                f"relative discrepancy of {value}, {where}, over the range {of}",
            )
            for quantity, value in (("velocity", "speed"), ("pressure", "pressure"))
            for place, where in COMPARED_AT
            for over, of in (("line", "on the line"), ("field", "of the whole field"))
        ),
        *(
            _series(f"{quantity}_{where}", "", f"r.m.s. error of {quantity} {meaning}")
            for quantity in ("velocity", "pressure")
            for where, meaning in (
                ("near_walls", "within a support radius of walls, over that of the whole field"),
                ("interior", "farther from walls, over the r.m.s. of the whole field"),
            )
        ),
        *_samples("centreline", "points of the centreline", "on the centreline"),
        *_samples("stations", "places where histories are kept", "at the stations"),
        *(
            DatasetField(f"reference/*/*/{name}", ("point",), "1", "", "", meaning, required=False)
            for name, meaning in (
                ("coordinate", "place along a reference's profile, over the reference length"),
                ("reference_value", "the reference there, over U, or rho U^2"),
                ("value", "the full run there, its mean over a window of time"),
                ("scatter", "standard deviation of its snapshots there in the window"),
            )
        ),
    ),
    (
        AttributeField("series/*/*/status", "text", "", "how the run ended", False),
        AttributeField("series/*/*/*", "float", "", "figure of merit over the whole run", False),
    ),
    at_least_one=("centreline/*/*",),
)


def _figure(name: str, units: str, meaning: str) -> DatasetField:
    return DatasetField(name, ("complete_run",), units, "", "", meaning)


SWEEP = Schema(
    "sphrom/sweep",
    "runs of one model at many parameter values, in the order of the values",
    (
        DatasetField(
            "parameters",
            ("run", "parameter"),
            "of the parameters",
            "mu",
            "Eq. 2.17",
            "parameter values of each run",
        ),
        DatasetField(
            "status",
            ("run",),
            "1",
            "",
            "",
            "how each run ended: 0 complete, 1 unstable, 2 failed for another reason, "
            "3 not run yet",
            dtype="int64",
        ),
        DatasetField(
            "complete",
            ("complete_run",),
            "1",
            "",
            "",
            "the runs that are complete, counted from zero; what follows is theirs",
            dtype="int64",
        ),
        _figure("time_step", "s", "time step of each run"),
        _figure("kinetic_energy", "J/m", "kinetic energy at the end"),
        _figure("largest_speed", "m/s", "largest speed of all points and snapshots"),
        DatasetField("time", ("snapshot",), "s", "t", "Eq. 2.18", "time of each snapshot", False),
        DatasetField(
            "generalized_coordinates",
            ("complete_run", "snapshot", "mode"),
            "of the inner product",
            "omega-hat",
            "Eq. 3.11",
            "coordinates of reduced runs",
            required=False,
        ),
        DatasetField(
            "probes/position",
            ("probe", "component"),
            "m",
            "x",
            "",
            "where velocity and pressure are kept",
            required=False,
        ),
        DatasetField(
            "probes/velocity",
            ("complete_run", "snapshot", "probe", "component"),
            "m/s",
            "u",
            "Eq. 2.7",
            "velocity there",
            required=False,
        ),
        DatasetField(
            "probes/pressure",
            ("complete_run", "snapshot", "probe"),
            "Pa",
            "p",
            "Eq. 2.8",
            "pressure there",
            required=False,
        ),
        DatasetField(
            "error_estimate/run",
            ("estimated_run",),
            "1",
            "",
            "",
            "the runs whose errors are estimated, counted from zero",
            required=False,
            dtype="int64",
        ),
        *(
            DatasetField(
                f"error_estimate/{name}",
                ("estimated_run",),
                "%",
                "",
                "",
                f"estimated error of the {meaning}, over its root mean square over the run",
                required=False,
            )
            for name, meaning in (("velocity", "velocity"), ("pressure", "pressure less its mean"))
        ),
        DatasetField(
            "error_estimate/extrapolated",
            ("estimated_run",),
            "1",
            "",
            "",
            "one where a run is outside of what its model was trained on, else zero",
            required=False,
            dtype="int64",
        ),
    ),
    (
        AttributeField("model", "text", "", "model that was run, full or a reduced model's name"),
        AttributeField("parameter_names", "text", "", "names of the parameters, with commas"),
        AttributeField(
            "failures/*", "text", "", "why a run, by its number, is not complete", False
        ),
        TIMING,
    ),
)

CHECKPOINT = Schema(
    "sphrom/checkpoint",
    "where a run that is not complete stands: what its next step depends on",
    (
        DatasetField(
            "state",
            ("row", "entry"),
            "of each row",
            "w",
            "Eq. 2.17",
            "the full or reduced state after the step, as the run holds it",
        ),
        DatasetField(
            "neighbours_at",
            ("component", "particle"),
            "m",
            "x",
            "Alg. 3.2",
            "positions that the list of neighbours was built at, unless it is to be built anew",
            required=False,
        ),
    ),
    (
        AttributeField("step", "int", "", "steps taken"),
        AttributeField("n_steps", "int", "", "steps of the whole run"),
        AttributeField("time", "float", "s", "time of the state"),
        AttributeField("generation", "int", "", "checkpoints of the run up to this one"),
        AttributeField("n_parts", "int", "", "files of snapshots that belong to it"),
        AttributeField("parts_sha256", "text", "", "digest of what they hold"),
        AttributeField(
            "computed_with", "text", "", "versions and processor that its last bits depend on"
        ),
        TIMING,
    ),
)

PART = Schema(
    "sphrom/trajectory-part",
    "snapshots of a run that is not complete, from one checkpoint to the next",
    tuple(field for field in TRAJECTORY.datasets if not field.name.startswith("ghost/")),
    (AttributeField("number", "int", "", "place in the order of parts, from 1"),),
)

SCHEMAS: dict[str, Schema] = {
    schema.name: schema
    for schema in (
        PACKING,
        STATE,
        TRAJECTORY,
        REFERENCE_SNAPSHOTS,
        BASIS,
        SPLINE,
        B_SPLINE,
        OPERATORS,
        COORDINATES,
        COMPARISON,
        SWEEP,
        CHECKPOINT,
        PART,
    )
}
