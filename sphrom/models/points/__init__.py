"""Reduced models from projected operators, on the points of the reference space."""
