"""A trained model as one JSON document; `docs/portable.md` describes it and how to evaluate it."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS
from sphrom.case.studies import trained_ranges
from sphrom.metrics.grids import Slices, grid_points
from sphrom.metrics.measures import Samples
from sphrom.models.contract import Ability, Model
from sphrom.sph.domain import Domain
from sphrom.version import __version__

FORMAT, VERSION = "sphrom model", 1
"""The name of the format, and its version: readers refuse a greater one."""
DIGITS = 7
"""Digits of coordinates of outlines."""


def document(model: Model[Any]) -> dict[str, Any]:
    """Return a model as a document, with arrays of NumPy in it.

    Raises CaseError that names the reason if the document can't represent the model.
    """
    model.family.require(Ability.PORTABLE, "export", model.section.name)
    case = model.workspace.case
    return with_digest(
        {
            "format": FORMAT,
            "version": VERSION,
            "sphrom": __version__,
            "case": case.name,
            "name": model.section.name,
            "parameters": _parameters(model),
            **model.family.part("portable")(model),
            "geometry": _geometry(case.scene.domain),
        }
    )


def with_digest(found: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document with the digest of its other keys."""
    rest = {key: value for key, value in found.items() if key != "digest"}
    digest = hashlib.sha256(json.dumps(encoded(rest)).encode()).hexdigest()
    return {**rest, "digest": digest}


def encoded(value: Any, kinds: Sequence[str] = ("f8", "i2", "u1")) -> Any:
    """Return a value for JSON: arrays as objects with their bytes in base64."""
    if isinstance(value, np.ndarray):
        kind = value.dtype.newbyteorder("<").str[1:]
        assert kind in kinds
        content = np.ascontiguousarray(value, dtype=f"<{kind}").tobytes()
        data = base64.b64encode(content).decode("ascii")
        return {"shape": list(value.shape), "type": kind, "data": data}
    if isinstance(value, dict):
        return {name: encoded(each) for name, each in value.items()}
    return [encoded(each) for each in value] if isinstance(value, (list, tuple)) else value


def content(model: Model[Any]) -> bytes:
    """Return the document of a model as a file has it; see `document`."""
    return json.dumps(encoded(document(model)), allow_nan=False).encode()


def fields(model: Model[Any], n_columns: int) -> dict[str, Any]:
    """Return velocity and pressure of the modes at the centres of a grid's cells.

    The grid is that of a picture, in three dimensions that of its slices. Outside of the fluid the
    fields are zero. Raises CaseError if the model has no such fields.
    """
    domain = model.workspace.case.scene.domain
    slices = Slices(domain.lower, domain.upper)
    left, right, bottom, top = slices.extent
    n_rows = max(1, round(n_columns * (top - bottom) / (right - left)))
    points = slices.places(grid_points((left, bottom), (right, top), (n_rows, n_columns)))
    inside = np.isfinite(points[:, 0])
    inside[inside] = domain.contains(points[inside])
    samples: Samples = model.family.part("mode_samples")(model, points[inside])
    n_dim = domain.n_dim
    modes = np.zeros((n_dim + 1, len(samples.pressure), len(points)), dtype=np.float32)
    modes[:n_dim, :, inside] = np.moveaxis(samples.velocity, 2, 0)
    modes[n_dim][:, inside] = samples.pressure
    found = {
        "nx": n_columns,
        "ny": n_rows,
        "lower": [left, bottom],
        "upper": [right, top],
        "inside": inside.reshape(n_rows, n_columns).astype(np.uint8),
        "modes": modes.reshape(n_dim + 1, -1, n_rows, n_columns),
    }
    return found if slices.is_plane else found | {"slices": slices.rectangles}


def _parameters(model: Model[Any]) -> list[dict[str, Any]]:
    case: Case = model.workspace.case
    scales = dict(zip(case.plan.parameter_names, case.plan.largest_values.tolist(), strict=True))
    return [
        {
            "name": name,
            "unit": "1",
            "default": math.sqrt(low * high) if name == REYNOLDS else 0.5 * (low + high),
            "low": low,
            "high": high,
            "scale": scales[name] or 1.0,
            "logarithm": name == REYNOLDS,
        }
        for name, (low, high) in trained_ranges(case, model.section).items()
    ]


def _geometry(domain: Domain) -> dict[str, Any]:
    return {
        "lower": list(domain.lower),
        "upper": list(domain.upper),
        "periodic": list(domain.periodic),
        "walls": list(domain.wall_names),
        "fluid": _polygons(domain.fluid) if domain.n_dim == 2 else [],
        "solids": [{"name": name, "polygons": _polygons(shape)} for name, shape in domain.polygons],
    }


def _polygons(shape: BaseGeometry) -> list[list[list[list[float]]]]:
    """Return the rings of polygons: outer ones, each with its holes."""
    parts = getattr(shape, "geoms", [shape])
    return [[_ring(ring.coords) for ring in (part.exterior, *part.interiors)] for part in parts]


def _ring(corners: Any) -> list[list[float]]:
    rows: Array = np.asarray(corners)[:, :2]
    return [[float(f"{value:.{DIGITS}g}") for value in row] for row in rows.tolist()]
