"""The lid's reference solution from rest: its program against what is stored."""

from __future__ import annotations

import numpy as np

from sphrom.scenes.reference_profiles import profiles_for


def test_few_modes_give_the_stored_profiles(script):
    lid_transient = script("lid_transient")
    stored = {
        profile.name: profile
        for profile in profiles_for("lid-driven-cavity", "regularised", 100.0)
        if profile.time == 1.0
    }
    cavity = lid_transient.Cavity(20, 0.01)
    state = cavity.integrate(1.0, 40, cavity.start())
    places = np.linspace(0.0, 1.0, 101)
    for name, line in zip(("u along y", "v along x"), cavity.profiles(state, places), strict=True):
        expected = np.interp(places, stored[name].coordinate, stored[name].value)
        assert np.abs(line - expected).max() < 1e-4, name
    cavity = lid_transient.Cavity(28, 0.01)
    for line in cavity.profiles(cavity.start(), np.linspace(0.0, 0.4, 5)):
        assert np.abs(line).max() < 1e-2  # it starts at rest
