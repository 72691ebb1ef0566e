"""Trained models in files of their own, for programs that run them without this package."""
