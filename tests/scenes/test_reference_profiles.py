"""The reference profiles: what is there, against figures of their sources, and one another."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.scenes.reference_profiles import ReferenceProfile, profiles_for


def _one(
    lid: str, reynolds: float, name: str, time: float | None = None, source: str = ""
) -> ReferenceProfile:
    (profile,) = [
        p
        for p in profiles_for("lid-driven-cavity", lid, reynolds)
        if p.name == name and p.time == time and p.source.startswith(source)
    ]
    return profile


@pytest.mark.parametrize(
    ("lid", "reynolds", "names"),
    [
        ("uniform", 100.0, ["u along y", "v along x"] * 2),
        ("uniform", 400.0 * (1.0 + 5e-7), ["u along y", "v along x"]),
        ("regularised", 100.0, ["p along y", "u along y", "v along x"] * 3),
        ("regularised", 200.0, ["p along y", *["u along y", "v along x"] * 3]),
        ("uniform", 400.0 * 1.001, []),
    ],
)
def test_what_is_known_of_the_driven_cavity(lid: str, reynolds: float, names: list[str]) -> None:
    """A Reynolds number is met to rounding."""
    known = profiles_for("lid-driven-cavity", lid, reynolds)
    assert sorted(p.name for p in known) == sorted(names)


def test_other_scenes() -> None:
    assert profiles_for("taylor-green", None, 100.0) == ()
    (mean,) = profiles_for("open-cavity", None, 2400.0)
    assert (mean.name, mean.averaged, mean.offset) == ("u along y", True, 1.25)
    assert mean.value[0] < 0.0 < mean.value[-1]
    assert mean.value.max() == pytest.approx(0.955)


def test_extrema_of_the_uniform_lid() -> None:
    """Botella & Peyret 1998, their table for Re = 100."""
    u, v = (_one("uniform", 100.0, name, source="Legendre") for name in ("u along y", "v along x"))
    assert u.value.min() == pytest.approx(-0.2140424, abs=2e-4)
    assert v.value.max() == pytest.approx(0.1795728, abs=2e-4)
    assert v.value.min() == pytest.approx(-0.2538030, abs=2e-4)


@pytest.mark.parametrize("name", ["u along y", "v along x"])
def test_two_sources_agree_as_well_as_the_older_is(name: str) -> None:
    ghia, spectral = (_one("uniform", 100.0, name, source=s) for s in ("Ghia", "Legendre"))
    between = np.interp(ghia.coordinate, spectral.coordinate, spectral.value)
    assert 1e-4 < np.abs(between - ghia.value).max() < 0.0095


def test_datums_of_the_pressure() -> None:
    steady = _one("regularised", 100.0, "p along y")
    assert steady.datum == "centre"
    assert np.interp(0.5, steady.coordinate, steady.value) == pytest.approx(0.0, abs=1e-3)
    assert _one("regularised", 100.0, "p along y", 5.0).datum == "mean"
