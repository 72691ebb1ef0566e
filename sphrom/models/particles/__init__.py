"""Reduced models on moving particles."""
