"""Reduced models of flows with a free surface."""
