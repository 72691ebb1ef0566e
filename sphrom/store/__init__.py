"""The artifacts of one case: paths, dependencies, validity, and reading for the numerics.

`sphrom.artifacts` writes and reads the files of any case.
"""
