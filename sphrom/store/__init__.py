"""The artifacts of one case: which there are, whether they are valid, what numerics need of them.

How a file of any case is written and read is for `sphrom.artifacts`.
"""
