"""Training of a reduced model for a region of parameters, with a choice of its full runs."""
