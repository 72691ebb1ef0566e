"""The errors of the package: each class has an exit code, each message suggests a remedy."""

from __future__ import annotations


class SphromError(Exception):
    """An error that a user can act on; the command line shows it without a traceback."""

    exit_code = 1


class CaseError(SphromError):
    """The case file or the command line is invalid."""

    exit_code = 2


class ArtifactError(SphromError):
    """An artifact is missing, damaged, of another case, or made from another input."""

    exit_code = 3


class UnstableError(SphromError):
    """A run diverged, or left the range in which its numbers are physical."""

    exit_code = 4


class ResourceError(SphromError):
    """A run does not fit the memory or the disk of this machine."""

    exit_code = 5
