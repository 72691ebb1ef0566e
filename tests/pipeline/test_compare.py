"""What `compare` does where a comparison has no meaning, and what it says of cost."""

from __future__ import annotations

from sphrom.errors import UnstableError
from sphrom.models.particles import runs as particle_runs


def test_probes_that_all_see_the_same_are_refused(place, refused):
    """The flow's symmetry gives every point of so coarse a set of probes one pressure."""
    command = ("compare", "tiny.yaml", "--force", "--set", "compare.grid=2")
    assert "compare.grid" in refused(*command, code=2)


def test_a_model_that_fails_at_its_start_is_reported(place, sphrom, errors_of, monkeypatch):
    """The others run all the same, and the table says which one did not."""

    def fail(*_: object) -> float:
        raise UnstableError("no density is left")

    monkeypatch.setattr(particle_runs, "reduced_jacobian", fail)
    result = sphrom("run", "tiny.yaml", "--force", "--set", "rom.1.advection=paper", code=4)
    assert "apg, reynolds=100: unstable at the start: no density is left" in result.stderr
    status = {row["compared"]: row["status"] for row in errors_of(place)}
    assert status["apg"] == "unstable"
    assert status["galerkin"] == "complete"
