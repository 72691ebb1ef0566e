"""The scene section of a case: the kinds of flow, with their geometry and their defaults."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.case.custom_scene import CustomScene
from sphrom.case.fields import Duration, Number, Positive, Section, key
from sphrom.case.measure_sections import MEASURE, Measures
from sphrom.case.scene_section import IN_SPACE, OF_WALLS, Defaults, SceneSection
from sphrom.scenes import flows
from sphrom.scenes.reference_profiles import OPEN_CAVITY_SPEED, ReferenceProfile, profiles_for
from sphrom.sph.fluid import NONE, Fluid
from sphrom.text import exact

PROBE_SHARE = 0.625
"""Place of the open cavity's profiles along its channel: at 0.25 m of the paper's 0.4 m."""


class TaylorGreenScene(SceneSection):
    """The Taylor-Green vortex in a periodic square (Eq. 4.4)."""

    title: ClassVar[str] = "The Taylor-Green vortex"

    kind: Literal["taylor-green"] = key(..., "kind of flow")
    length: Positive = key(1.0, "side of the periodic square", unit="m")
    pressure_sign: Literal["exact", "paper"] = key(
        "exact", "sign of the initial pressure: exact, or as printed in Eq. 4.4"
    )
    measure: Measures = MEASURE

    def flow(self, scales: flows.Scales) -> flows.Scene:
        return flows.TaylorGreen(
            length=self.length,
            speed=scales.speed,
            reference_density=scales.density,
            kinematic_viscosity=scales.kinematic_viscosity,
            pressure_sign=-1.0 if self.pressure_sign == "paper" else 1.0,
        )


class TaylorGreen3DScene(SceneSection):
    """The Taylor-Green vortex in a periodic cube."""

    title: ClassVar[str] = "The Taylor-Green vortex in three dimensions"
    defaults: ClassVar[Defaults] = {**IN_SPACE, "compare": {"exact": False}}

    kind: Literal["taylor-green-3d"] = key(..., "kind of flow")
    length: Positive = key(2.0 * math.pi, "side of the periodic cube", unit="m")
    measure: Measures = MEASURE

    def flow(self, scales: flows.Scales) -> flows.Scene:
        return flows.TaylorGreen3D(self.length, scales.speed, scales.density)

    @property
    def length_scale(self) -> float:
        """L of the Reynolds number, with which the wave number is one [m]."""
        return self.length / (2.0 * math.pi)


class LidDrivenCavityScene(SceneSection):
    """The lid-driven cavity: a closed square box whose top wall moves (section 4.2)."""

    title: ClassVar[str] = "The lid-driven cavity"
    cavity: ClassVar[type[flows.LidDrivenCavity]] = flows.LidDrivenCavity
    defaults: ClassVar[Defaults] = {
        **OF_WALLS,
        "time": {"final_time": 10.0},
        "parameters": {"train": {"reynolds": [100.0]}},
    }

    kind: Literal["lid-driven-cavity"] = key(..., "kind of flow")
    length: Positive = key(1.0, "side of the box", unit="m")
    lid: Literal["regularised", "uniform"] = key(
        "regularised",
        "velocity of the lid: falling to zero at its ends, or fluid.reference_speed everywhere",
    )
    lid_ramp: Duration = key(
        0.0,
        "time in which the lid reaches its speed: 0 is an impulsive start, as in the paper, "
        "which also produces sound; 3 length / c0 produces none",
        unit="s",
    )
    measure: Measures = MEASURE

    def flow(self, scales: flows.Scales) -> flows.Scene:
        speed = scales.values.get("lid", scales.speed)
        return self.cavity(self.length, speed, lid=self.lid, ramp=self.lid_ramp)

    @property
    def ramp(self) -> float:
        return self.lid_ramp

    def parameters(self, reference_speed: float) -> dict[str, float]:
        """Return the lid's speed [m/s]."""
        return {"lid": reference_speed}

    def driving(self, names: Collection[str]) -> tuple[str, ...]:
        """Return the lid, if its speed is a parameter."""
        return tuple(name for name in names if name == "lid")

    def largest_wall_speed(self, values: Mapping[str, float], until: float = 0.0) -> float:
        """Return the lid's largest speed [m/s]."""
        return abs(values.get("lid", 0.0))

    def reference_profiles(
        self, reynolds: float, reference_speed: float
    ) -> tuple[ReferenceProfile, ...]:
        """Return the profiles for this lid; transient ones only if it starts at once."""
        profiles = profiles_for(self.kind, self.lid, reynolds)
        return profiles if self.lid_ramp == 0.0 else tuple(p for p in profiles if p.time is None)

    def problems(self, final_time: float, fluid: Fluid) -> Iterator[tuple[str, str]]:
        """Refuse a lid that does not reach its speed before the end."""
        if self.lid_ramp >= final_time:
            end = exact(final_time)
            ramp = exact(self.lid_ramp)
            yield "lid_ramp", f"must end before time.final_time, {end} s; got {ramp}"


class LidDrivenCubeScene(LidDrivenCavityScene):
    """The lid-driven cavity in three dimensions: a closed cube whose top wall moves along x."""

    title: ClassVar[str] = "The lid-driven cube"
    cavity: ClassVar[type[flows.LidDrivenCavity]] = flows.LidDrivenCube
    defaults: ClassVar[Defaults] = {**LidDrivenCavityScene.defaults, **IN_SPACE}

    kind: Literal["lid-driven-cube"] = key(..., "kind of flow")  # type: ignore[assignment]


class BodyForceSection(Section):
    """The body force above the cavity, b0 [1 / (1 + exp(k (t - f0))) + k0] (Eq. 4.5)."""

    magnitude: Positive = key(flows.LogisticForce.magnitude, "b0", unit="m/s2")
    rate: Positive = key(flows.LogisticForce.rate, "k", unit="1/s")
    switch_time: Positive = key(flows.LogisticForce.switch_time, "f0", unit="s")
    sustained_share: Number = key(
        flows.LogisticForce.sustained_share,
        "k0, the share of b0 that always acts",
        unit="-",
        ge=0.0,
        le=1.0,
    )
    form: Literal["kick", "ramp-up"] = key(
        flows.LogisticForce.form,
        "kick: b0 until f0, as printed in Eq. 4.5; ramp-up: b0 from f0 on, with the sign of k "
        "reversed",
    )


class OpenCavityScene(SceneSection):
    """The open cavity: a periodic channel over a cavity, driven by a body force (section 4.3)."""

    title: ClassVar[str] = "The open cavity"
    defaults: ClassVar[Defaults] = {
        **OF_WALLS,
        "fluid": {"reference_density": 1.0, "reference_speed": 2.0},
        "discretization": {"smoothing_length_ratio": 2.0, "resolution": 200},
        # Vortices are shed, so another step gives another flow; published figures use this one.
        "time": {"spin_up": 5.0, "final_time": 6.0, "courant_number": 0.75},
        "parameters": {"train": {"reynolds": [2400.0]}},
    }

    kind: Literal["open-cavity"] = key(..., "kind of flow")
    body_force: BodyForceSection = key(
        BodyForceSection(), "body force above the cavity, which drives the flow (Eq. 4.5)"
    )
    measure: Measures = MEASURE

    @cached_property
    def _cavity(self) -> flows.OpenCavity:
        return flows.OpenCavity(force=self._force(NONE))

    def _force(self, values: Mapping[str, float]) -> flows.LogisticForce:
        own = self.body_force.model_dump()
        return flows.LogisticForce(
            **{**own, "magnitude": values.get("body_force", own["magnitude"])}
        )

    def flow(self, scales: flows.Scales) -> flows.Scene:
        """Return the cavity; the body force determines the speed of its flow."""
        return replace(self._cavity, force=self._force(scales.values))

    def parameters(self, reference_speed: float) -> dict[str, float]:
        """Return the magnitude of the body force, b0 [m/s2]."""
        return {"body_force": self.body_force.magnitude}

    @property
    def length_scale(self) -> float:
        return self._cavity.cavity_length

    @property
    def probe_line(self) -> float:
        return PROBE_SHARE * self._cavity.channel_length

    def largest_head(self, final_time: float, values: Mapping[str, float] = NONE) -> float:
        """Return the head of the force minus its mean along the channel [m2/s2]."""
        cavity = self._cavity.cavity_length
        length = self._cavity.channel_length
        return abs(self._force(values).largest) * cavity * (1.0 - cavity / length)

    def stations(self, line: float) -> Array:
        """Return the place on the line in the shear layer over the cavity (1, 2) [m]."""
        return np.array([[line, self._cavity.cavity_height]])

    @property
    def channel(self) -> flows.Channel:
        """The channel beside the cavity; above the cavity, part of the flow turns back below."""
        cavity = self._cavity.cavity

        def beside(position: Array) -> NDArray[np.bool_]:
            x, y = position.T
            outside = (x < cavity.lower[0]) | (x > cavity.upper[0])
            return (y > cavity.upper[1]) & outside

        return flows.Channel(self._cavity.channel_height, beside)

    def reference_profiles(
        self, reynolds: float, reference_speed: float
    ) -> tuple[ReferenceProfile, ...]:
        """Return the profiles of the flow with the default body force; none with another."""
        if self.body_force != BodyForceSection() or reference_speed != OPEN_CAVITY_SPEED:
            return ()
        return profiles_for(self.kind, None, reynolds)


AnyScene = (
    TaylorGreenScene
    | TaylorGreen3DScene
    | LidDrivenCavityScene
    | LidDrivenCubeScene
    | OpenCavityScene
    | CustomScene
)
"""Every kind of scene that a case can have."""


def kind_of_section(section: type[SceneSection]) -> str:
    """Return the kind of flow of a section."""
    return str(get_args(section.model_fields["kind"].annotation)[0])


DEFAULTS: Mapping[str, Defaults] = {
    kind_of_section(section): section.defaults for section in get_args(AnyScene)
}
"""Defaults by kind of scene, where they differ from those of the sections."""


def with_defaults(values: Any, defaults: Defaults) -> Any:
    """Return a mapping with missing values filled by defaults, section by section."""
    if not isinstance(values, Mapping):
        return values
    merged = dict(values)
    for name, default in defaults.items():
        if isinstance(default, Mapping):
            merged[name] = with_defaults(values.get(name, {}), default)
        else:
            merged.setdefault(name, default)
    return merged


def is_in_space(scene: Any) -> bool:
    """Return whether a scene's plain values have a three-dimensional box."""
    box = scene.get("box") if isinstance(scene, Mapping) else None
    lower = box.get("lower") if isinstance(box, Mapping) else None
    return isinstance(lower, list | tuple) and len(lower) == 3


def kind_of(case: Any) -> str:
    """Return the kind of scene in a case's plain values, or an empty text."""
    scene = case.get("scene") if isinstance(case, Mapping) else None
    kind = scene.get("kind") if isinstance(scene, Mapping) else None
    return kind if isinstance(kind, str) else ""
