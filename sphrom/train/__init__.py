"""Training that chooses its full runs: a reduced model for a region of the parameters."""
