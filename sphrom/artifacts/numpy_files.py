"""Read NumPy's archives (.npz), which may be damaged or hostile.

What an archive unpacks to is looked at before anything is: zeros take a thousandth of their size.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import Fault, require_snapshot_size

MOST_ARRAYS = 1000
"""Of one archive."""
_SUFFIX = ".npy"


def read_archive(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive by name. Raises Fault."""
    if not zipfile.is_zipfile(path):
        raise Fault("is not a NumPy archive as numpy.savez writes it, or is damaged")
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if m.filename.endswith(_SUFFIX)]
            _refuse_large(members)
            return {m.filename.removesuffix(_SUFFIX): _read(archive, m) for m in members}
    except Fault:
        raise
    except Exception as error:  # whatever a damaged archive makes of its parsers
        raise Fault(f"is damaged: {_reason(error)}") from error


def _refuse_large(members: list[zipfile.ZipInfo]) -> None:
    if len(members) > MOST_ARRAYS:
        raise Fault(f"holds {len(members)} arrays; a snapshot has at most {MOST_ARRAYS}")
    require_snapshot_size(sum(member.file_size for member in members))


def _read(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as stream:
        try:
            values: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        except (Exception, MemoryError) as error:
            if "Object arrays" in str(error):
                raise Fault(
                    f"holds Python objects ({member.filename}), which can run code when they are "
                    "read: it is refused; PySPH writes plain HDF5 instead where h5py is installed"
                ) from error
            raise Fault(f"is damaged: {member.filename}: {_reason(error)}") from error
    return values


def _reason(error: BaseException) -> str:
    """Return what an error says on one line, or its kind where it says nothing."""
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__
