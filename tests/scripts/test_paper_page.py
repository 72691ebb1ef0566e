"""What the page of the paper's claims computes: phases of runs, and costs of models."""

from __future__ import annotations

import numpy as np
import pytest


def test_a_phase_that_drifts_is_followed_beyond_half_a_period(script) -> None:
    """Ahead is positive: a wave that comes early has its crest early."""
    phase_lead = script("paper_page").phase_lead
    time = 5.0 + np.linspace(0.0, 1.0, 801)
    reference = 3.0 + np.sin(2.0 * np.pi * 4.6 * time + 1.0)
    ahead = 2.0 * np.sin(2.0 * np.pi * 4.6 * (time + 0.1 / 4.6) + 1.0)
    np.testing.assert_allclose(phase_lead(time, ahead, reference, 4.6), 0.1, atol=2e-3)
    np.testing.assert_allclose(phase_lead(time, reference, ahead, 4.6), -0.1, atol=2e-3)
    faster = np.sin(2.0 * np.pi * 5.4 * (time - 5.0) + 2.0 * np.pi * 4.6 * 5.0 + 1.0)
    lead = phase_lead(time, faster, reference, 4.6)
    assert lead[0] == pytest.approx(0.8 * 0.5 / 4.6, abs=0.03)
    assert lead[-1] == pytest.approx(0.8 * (1.0 - 0.5 / 4.6), abs=0.03)
    with pytest.raises(ValueError, match="a period or more"):
        phase_lead(time, reference, reference, 0.5)


def test_costs_are_means_over_the_parameters_of_a_model(script) -> None:
    page = script("paper_page")
    row = {"model": "fast", "n_modes": 5, **dict.fromkeys(page.COST_COLUMNS, 2.0)}
    rows = page.cost_rows({"timings": [row, {**row, "speed_up": 4.0}, {**row, "model": "apg"}]})
    assert [cells[0] for cells in rows] == ["fast", "apg"]
    assert rows[0][1:] == ["5", "2.00", "2.00", "2.00", "2.00", "3.00", "2.00 to 2.00"]
    assert len(rows[0]) == len(page.COSTS.split("|"))


def test_claims_of_a_reading_that_was_not_run_stay_in_the_documentation(script, tmp_path) -> None:
    docs, headings = script("paper_docs"), script("paper_page").HEADINGS
    write_csv = script("paper_page").write_csv
    fresh, stored = tmp_path / "claims.csv", tmp_path / "scene.csv"
    corrected = [name for name in headings if name != "as printed"]
    write_csv(fresh, [corrected, ["Fig. 1", "u", "2", "3", "4", "5"], ["Fig. 2", *"v12345"[:5]]])
    write_csv(stored, [headings, ["Fig. 1", "u", "2", "7", "8", "9", "9"], ["gone", *"u12345"]])
    docs._write_claims(fresh, stored, {"corrected"})
    rows = stored.read_text(encoding="utf-8").splitlines()
    assert rows[1:] == ["Fig. 1,u,2,7,3,4,5", "Fig. 2,v,1,–,2,3,4"]
