"""Reduced models: the stages that make them, and their runs, by family."""
