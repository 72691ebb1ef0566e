"""The named scenes in terms of a scene of kind custom: what each would be as a case of one's own.

The discretization differs: round solids and blocks are packed against, where the named scenes have
a lattice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import singledispatch
from typing import Any

from sphrom.case.models import Case
from sphrom.case.scene_section import SceneSection
from sphrom.case.scenes import LidDrivenCavityScene, OpenCavityScene, TaylorGreenScene
from sphrom.case.yaml_reader import dump_yaml
from sphrom.scenes.lid_driven_cavity import LID_EXPONENT

Values = Mapping[str, Any]


def equivalent(case: Case) -> tuple[Values, str]:
    """Return the section of a scene of kind custom that a case's scene is, and what it leaves out.

    The section is empty where the scene is of that kind already.
    """
    section, left_out = _equivalent(case.scene, case)
    if section and case.scene.measure:
        given = case.scene.model_dump(mode="json", include={"measure"}, exclude_none=True)
        section = {**section, **given}
    return section, left_out


def comment(case: Case) -> str:
    """Return lines of YAML comment that say what a named scene is; none for kind custom."""
    section, left_out = equivalent(case)
    if not section:
        return ""
    head = ["As a scene of kind custom, and packed:", *([left_out] if left_out else []), ""]
    lines = [*head, *dump_yaml({"scene": {"kind": "custom", **section}}).splitlines()]
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


@singledispatch
def _equivalent(scene: SceneSection, case: Case) -> tuple[Values, str]:
    return {}, ""


@_equivalent.register
def _(scene: TaylorGreenScene, case: Case) -> tuple[Values, str]:
    sign = "-" if scene.pressure_sign == "paper" else ""
    section = {
        "box": _box(scene, "x", "y"),
        "constants": {
            "k": 2.0 * math.pi / scene.length,
            "U": case.fluid.reference_speed,
            "rho": case.fluid.reference_density,
        },
        "initial": {
            "u": "U*sin(k*x)*cos(k*y)",
            "v": "-U*cos(k*x)*sin(k*y)",
            "p": f"{sign}0.25*rho*U**2*(cos(2*k*x) + cos(2*k*y))",
        },
    }
    return section, ""


@_equivalent.register
def _(scene: LidDrivenCavityScene, case: Case) -> tuple[Values, str]:
    profile = f"U*(1 - (2*x/L - 1)**{LID_EXPONENT})**2" if scene.lid == "regularised" else "U"
    section = {
        "box": _box(scene),
        "walls": {"top": {"velocity": [profile, 0]}},
        "constants": {"U": case.fluid.reference_speed, "L": scene.length},
    }
    return section, "The lid's ramp is left out." if scene.lid_ramp else ""


@_equivalent.register
def _(scene: OpenCavityScene, case: Case) -> tuple[Values, str]:
    length, height = scene.channel_length, scene.cavity_height
    left = 0.5 * (length - scene.cavity_length)
    right = left + scene.cavity_length
    force = scene.body_force
    sign = "" if force.form == "kick" else "-"
    section = {
        "box": _box(scene, "x"),
        "solids": {
            "upstream": {"rectangle": {"lower": [0.0, 0.0], "upper": [left, height]}},
            "downstream": {"rectangle": {"lower": [right, 0.0], "upper": [length, height]}},
        },
        "constants": {
            "left": left, "right": right, "height": height, "b0": force.magnitude,
            "k": force.rate, "f0": force.switch_time, "k0": force.sustained_share,
        },
        "body_force": [
            "where(x >= left, 1, 0)*where(x <= right, 1, 0)*where(y >= height, 1, 0)"
            f"*b0*(1/(1 + exp({sign}k*(t - f0))) + k0)",
            0,
        ],
        "reference_length": scene.cavity_length,
    }  # fmt: skip
    return section, "Its discretization.resolution counts particles along reference_length."


def _box(scene: SceneSection, *periodic: str) -> Values:
    domain = scene.domain
    sides = {"lower": list(domain.lower), "upper": list(domain.upper)}
    return {**sides, "periodic": list(periodic)} if periodic else sides
