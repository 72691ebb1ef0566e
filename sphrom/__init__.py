"""sphrom: reduced models of smoothed-particle hydrodynamics."""

__version__ = "0.1.0"
