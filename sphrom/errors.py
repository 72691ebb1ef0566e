"""The vocabulary of errors: each class is an exit code, each message says what to do next."""

from __future__ import annotations


class SphromError(Exception):
    """An error that a user can act on; its text is shown without a traceback."""

    exit_code = 1


class CaseError(SphromError):
    """The case file, or the command line, asks for something invalid."""

    exit_code = 2


class ArtifactError(SphromError):
    """An artifact is missing, damaged, of another case, or made from another input."""

    exit_code = 3


class UnstableError(SphromError):
    """A run left the range in which its numbers mean anything."""

    exit_code = 4


class ResourceError(SphromError):
    """A run was asked for that would not fit this machine."""

    exit_code = 5
