"""Where a case measures fields, as plain arrays."""

from __future__ import annotations

import numpy as np

from sphrom.case.measures import MeasureSection
from sphrom.case.models import Case
from sphrom.metrics.measures import FieldMeasure


def field_measures(case: Case) -> dict[str, FieldMeasure]:
    """Return where a case measures fields, by the names of the measurements."""
    spacing = case.particle_spacing
    return {name: _measure(m, spacing) for name, m in case.scene.measured_fields.items()}


def _measure(section: MeasureSection, spacing: float) -> FieldMeasure:
    if section.flow_rate is not None:
        ends = np.array(section.flow_rate.start), np.array(section.flow_rate.end)
        return FieldMeasure.section(*ends, longest=spacing)
    if section.line is not None:
        ends = np.array(section.line.start), np.array(section.line.end)
        return FieldMeasure.line(*ends, section.line.points)
    return FieldMeasure(np.array([section.probe]))
