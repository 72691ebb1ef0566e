"""The scene section of a case: a kind of flow and its geometry, and the defaults right for each."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Literal

from sphrom.case.fields import Duration, Number, Positive, Section, key
from sphrom.scenes.lid_driven_cavity import LidDrivenCavity
from sphrom.scenes.open_cavity import LogisticForce, OpenCavity
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain

PROBE_SHARE = 0.625
"""Where in the open cavity's channel profiles are taken: at 0.25 m of the paper's 0.4 m."""


class SceneSection(Section):
    """What follows from every kind of scene."""

    @property
    @abstractmethod
    def domain(self) -> Domain:
        """Where the fluid is."""

    @property
    def resolved_length(self) -> float:
        """The length that discretization.resolution counts particles along [m]."""
        return self.domain.lengths[0]

    @property
    def reference_length(self) -> float:
        """L of the Reynolds number [m]."""
        return self.resolved_length

    @property
    def probe_line(self) -> float:
        """x of the vertical line that runs are compared along [m]."""
        return 0.5 * self.domain.lengths[0]

    @property
    def largest_body_force(self) -> float:
        """What the body force's acceleration never exceeds [m/s2]."""
        return 0.0

    @property
    def drive_changes(self) -> bool:
        """Whether what drives the flow, a force or walls, changes with time."""
        return self.largest_body_force > 0.0

    @property
    def has_exact_solution(self) -> bool:
        """Whether an exact solution is known."""
        return False


class TaylorGreenScene(SceneSection):
    """The Taylor-Green vortex in a periodic square (Eq. 4.4)."""

    kind: Literal["taylor-green"] = key(..., "which flow")
    length: Positive = key(1.0, "side of the periodic square", unit="m")
    pressure_sign: Literal["exact", "paper"] = key(
        "exact", "sign of the initial pressure: exact, or as printed in Eq. 4.4"
    )

    @property
    def domain(self) -> Domain:
        """The periodic square."""
        return BoxDomain((0.0, 0.0), (self.length, self.length), (True, True))

    @property
    def has_exact_solution(self) -> bool:
        """Whether an exact solution is known: it is."""
        return True


class LidDrivenCavityScene(SceneSection):
    """The lid-driven cavity: a closed square box whose top wall moves (section 4.2)."""

    kind: Literal["lid-driven-cavity"] = key(..., "which flow")
    length: Positive = key(1.0, "side of the box", unit="m")
    lid: Literal["regularised", "uniform"] = key(
        "regularised",
        "the lid's velocity: falling to zero at its ends, or fluid.reference_speed all along",
    )
    lid_ramp: Duration = key(
        0.0,
        "how long the lid takes to come up to speed: 0 starts it at once, as in the paper, and "
        "sound with it; 3 length / c0 is silent",
        unit="s",
    )

    @property
    def domain(self) -> Domain:
        """The box, walls all around."""
        return LidDrivenCavity(self.length, speed=0.0).domain

    @property
    def drive_changes(self) -> bool:
        """Whether the lid takes time to come up to speed."""
        return self.lid_ramp > 0.0


class BodyForceSection(Section):
    """The body force above the cavity, b0 [1 / (1 + exp(k (t - f0))) + k0] (Eq. 4.5)."""

    magnitude: Positive = key(LogisticForce.magnitude, "b0", unit="m/s2")
    rate: Positive = key(LogisticForce.rate, "k", unit="1/s")
    switch_time: Positive = key(LogisticForce.switch_time, "f0", unit="s")
    sustained_share: Number = key(
        LogisticForce.sustained_share,
        "k0, the share of b0 that acts all the time",
        unit="-",
        ge=0.0,
        le=1.0,
    )
    form: Literal["kick", "ramp-up"] = key(
        LogisticForce.form,
        "kick: b0 until f0, as Eq. 4.5 prints it; ramp-up: b0 from f0 on, the sign of k turned",
    )


class OpenCavityScene(SceneSection):
    """The open cavity: a periodic channel over a cavity, driven by a body force (section 4.3)."""

    kind: Literal["open-cavity"] = key(..., "which flow")
    channel_length: Positive = key(OpenCavity.channel_length, "length of the channel", unit="m")
    channel_height: Positive = key(OpenCavity.channel_height, "height of the channel", unit="m")
    cavity_length: Positive = key(
        OpenCavity.cavity_length, "length of the cavity, midway along the channel", unit="m"
    )
    cavity_height: Positive = key(
        OpenCavity.cavity_height, "depth of the cavity below the channel", unit="m"
    )
    body_force: BodyForceSection = key(
        BodyForceSection(), "what drives the flow, above the cavity (Eq. 4.5)"
    )

    @property
    def flow(self) -> OpenCavity:
        """The scene that is simulated."""
        return OpenCavity(
            **self.model_dump(exclude={"kind", "body_force"}),
            force=LogisticForce(**self.body_force.model_dump()),
        )

    @property
    def domain(self) -> Domain:
        """Channel and cavity."""
        return self.flow.domain

    @property
    def reference_length(self) -> float:
        """L of the Reynolds number, the cavity's length [m]."""
        return self.cavity_length

    @property
    def probe_line(self) -> float:
        """x of the vertical line that runs are compared along [m]."""
        return PROBE_SHARE * self.channel_length

    @property
    def largest_body_force(self) -> float:
        """What the body force's acceleration never exceeds [m/s2]."""
        return self.flow.force.largest


Defaults = Mapping[str, Any]
_CAVITY: Defaults = {
    "fluid": {"reference_density": 1.0},
    "discretization": {
        "smoothing_length_ratio": 2.0,
        "initial_particles": "lattice",
    },
    "psi": {"polynomial_degree": 3},
    "compare": {"exact": False},
}
DEFAULTS: Mapping[str, Defaults] = {
    "lid-driven-cavity": {
        **_CAVITY,
        "time": {"final_time": 10.0},
        "parameters": {"train": {"reynolds": [100.0]}},
    },
    "open-cavity": {
        **_CAVITY,
        "fluid": {"reference_density": 1.0, "reference_speed": 2.0},
        "discretization": {**_CAVITY["discretization"], "resolution": 200},
        # Vortices are shed: another step gives another flow, and what was measured is of this one.
        "time": {"spin_up": 5.0, "final_time": 6.0, "courant_number": 0.75},
        "parameters": {"train": {"reynolds": [2400.0]}},
    },
}
"""Defaults, by kind of scene, that differ from those of the sections themselves."""


def with_defaults(given: Any, defaults: Defaults) -> Any:
    """Return the values of a mapping with defaults where none is given, section by section."""
    if not isinstance(given, Mapping):
        return given
    merged = dict(given)
    for name, default in defaults.items():
        if isinstance(default, Mapping):
            merged[name] = with_defaults(given.get(name, {}), default)
        else:
            merged.setdefault(name, default)
    return merged


def kind_of(case: Any) -> str:
    """Return the kind of scene that a case's plain values ask for, or nothing."""
    scene = case.get("scene") if isinstance(case, Mapping) else None
    kind = scene.get("kind") if isinstance(scene, Mapping) else None
    return kind if isinstance(kind, str) else ""
