"""Artifacts as xarray sees them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from sphrom.signals import guarded

if TYPE_CHECKING:
    import xarray


@guarded(computes=False)
def open(path: str | os.PathLike[str], group: str = "") -> xarray.Dataset:
    """Open an artifact, or a group of one such as `bases/all`, as a dataset with named axes.

    Variables are called as in `sphrom/artifacts.md`, `_` in place of `/`, and carry their units
    and meaning. Snapshots can be selected by time: `run.velocity.sel(time=0.1, method="nearest")`.
    The attribute `groups` lists the groups of an artifact that has some; a group comes with what
    belongs to all of them.

    Opening checks that the file is a whole artifact, and verifies datasets of up to 1 MiB. A larger
    one is verified, block by block, when values of it are first used. Values are read when they
    are used, so the file stays open until the dataset is closed; use `with`, or `load`.

    Raises ArtifactError when the file is missing, damaged or no artifact, CaseError when it has no
    such group.
    """
    from sphrom.artifacts.labelled import open_labelled

    return open_labelled(Path(path), group)


@guarded(computes=False)
def open_tree(path: str | os.PathLike[str]) -> xarray.DataTree:
    """Open an artifact with all of its groups, such as every basis of `pod.h5`.

    Each node is a dataset as `open` gives it, without what belongs to all groups: that is at the
    root.

    Raises ArtifactError when the file is missing, damaged or no artifact.
    """
    from sphrom.artifacts.labelled import open_labelled_tree

    return open_labelled_tree(Path(path))
