"""Ways to damage what sphrom reads: bytes of any file, and what an HDF5 file holds.

Each changes a file in place, drawn by a random generator.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.contents import CASE, DIGEST, VIEW

Mutation = Callable[[Path, random.Random], None]


def change_bytes(path: Path, random_: random.Random) -> None:
    """Flip bits, cut, fill, copy or insert some bytes."""
    content = bytearray(path.read_bytes())
    for _ in range(random_.choice((1, 1, 2, 8))):
        at = random_.randrange(len(content))
        if random_.random() < 0.3:  # where HDF5 has its structures
            at = random_.randrange(min(4096, len(content)))
        length = random_.choice((1, 4, 8, 64, 512))
        action = random_.randrange(6)
        if action == 0:
            content[at] ^= 1 << random_.randrange(8)
        elif action == 1:
            content[at : at + length] = bytes(len(content[at : at + length]))
        elif action == 2:
            content[at : at + length] = b"\xff" * len(content[at : at + length])
        elif action == 3:
            start = random_.randrange(len(content))
            content[at : at + length] = content[start : start + length]
        elif action == 4:
            content[at:at] = random_.randbytes(length)
        else:
            del content[random_.choice((at, at, 0)) :]
        if not content:
            break
    path.write_bytes(content)


# Values: HDF5's checksums hold --------------------------------------------------------------------


def change_values(path: Path, random_: random.Random) -> None:
    """Change values of a dataset or an attribute, as a lost block or another program does."""
    with h5py.File(path, "r+") as file:
        if random_.random() < 0.2:
            _change_attribute(file, random_)
            return
        names = [n for n, shape in _numbers(file).items() if np.prod(shape)]
        dataset = file[random_.choice(names)]
        values = dataset[...]
        random_.choice(VALUES)(values, random_)
        dataset[...] = values


def zero_chunk(path: Path, random_: random.Random) -> None:
    """Zero the bytes of a chunk: its checksum is that of zeros."""
    with h5py.File(path) as file:
        chunks = [
            file[name].id.get_chunk_info(index)
            for name in _numbers(file)
            if file[name].chunks
            for index in range(file[name].id.get_num_chunks())
        ]
    if chunks:
        chunk = random_.choice(chunks)
        with path.open("r+b") as stream:
            stream.seek(chunk.byte_offset)
            stream.write(bytes(chunk.size))


def _numbers(file: h5py.File) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the signed datasets."""
    found: dict[str, tuple[int, ...]] = {}

    def visit(name: str, item: h5py.HLObject) -> None:
        signed = isinstance(item, h5py.Dataset) and DIGEST in item.attrs
        if signed and name != CASE and not name.startswith(VIEW):
            found[name] = item.shape

    file.visititems(visit)
    return found


def _change_attribute(file: h5py.File, random_: random.Random) -> None:
    numbers = [k for k, value in file.attrs.items() if isinstance(value, float)]
    names = [name for name in numbers if name != "wall_seconds"]
    if names:
        name = random_.choice(names)
        file.attrs[name] *= random_.choice((0.0, -1.0, 1.0 + 1e-15, 1e300, 2.0))


def _at(value: float) -> Callable[[NDArray[Any], random.Random], None]:
    def change(values: NDArray[Any], random_: random.Random) -> None:
        limit = np.iinfo(values.dtype) if values.dtype.kind in "iu" else None
        kept = value if limit is None else int(min(limit.max, max(limit.min, value)))
        values.flat[random_.randrange(values.size)] = kept

    return change


def _zero_row(values: NDArray[Any], random_: random.Random) -> None:
    values[random_.randrange(len(values))] = 0


def _swap_rows(values: NDArray[Any], random_: random.Random) -> None:
    i, j = random_.randrange(len(values)), random_.randrange(len(values))
    values[[i, j]] = values[[j, i]]


def _reverse(values: NDArray[Any], _: random.Random) -> None:
    values[...] = values[::-1].copy()


def _nudge(values: NDArray[Any], _: random.Random) -> None:
    values[...] = np.nextafter(values, 1e9) if values.dtype.kind == "f" else values + 1


def _scale(values: NDArray[Any], random_: random.Random) -> None:
    values[...] = values * random_.choice((-1, 0, 2, 1000))


VALUES: list[Callable[[NDArray[Any], random.Random], None]] = [
    _zero_row, _swap_rows, _reverse, _nudge, _scale,
    _at(1e300), _at(-1e300), _at(0.0), _at(1e9), _at(-1.0),
]  # fmt: skip


# Structure ----------------------------------------------------------------------------------------


def change_structure(path: Path, random_: random.Random) -> None:
    """Change what the file holds, as another program could."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visititems(
            lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
        )
        name = random_.choice(names)
        random_.choice(STRUCTURES)(file, name, random_)


def _replace(file: h5py.File, name: str, **dataset: Any) -> None:
    del file[name]
    file.create_dataset(name, **dataset)


def _with_nan(file: h5py.File, name: str, _: random.Random) -> None:
    values = np.array(file[name], dtype=float) if name != "case" else np.zeros(3)
    values[...] = np.nan
    _replace(file, name, data=values)


def _outside(file: h5py.File, name: str, random_: random.Random) -> None:
    kind = random_.randrange(4)
    shape = file[name].shape
    del file[name]
    if kind == 0:
        file[name] = h5py.ExternalLink("/etc/hostname", "/x")
    elif kind == 1:
        file[name] = h5py.SoftLink("/" + name)
    elif kind == 2:
        file.create_dataset(
            name, shape or (1,), "f8", external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
        )
    else:
        layout = h5py.VirtualLayout(shape or (1,), "f8")
        layout[...] = h5py.VirtualSource("/etc/hostname", "x", shape or (1,))
        file.create_virtual_dataset(name, layout)


def _attribute(file: h5py.File, _: str, random_: random.Random) -> None:
    key = random_.choice(list(file.attrs))
    value = random_.choice(
        (np.nan, -1, 0, 1e300, np.bytes_(b"\xff\0x"), np.bytes_("2.0"), "vlen", np.zeros(9), None)
    )
    del file.attrs[key]
    if value is not None:
        file.attrs[key] = value


def _fan_out(file: h5py.File) -> None:
    """Give each group two names, level after level."""
    group = file.create_group("fan")
    for _ in range(19):
        below = group.create_group("a")
        group["b"] = below
        group = below


STRUCTURES: list[Callable[[h5py.File, str, random.Random], None]] = [
    _with_nan,
    _outside,
    _attribute,
    lambda file, name, _: file.__delitem__(name),
    lambda file, name, _: _replace(file, name, data=["text", "more"]),
    lambda file, name, _: _replace(file, name, data=np.zeros(3, [("a", "f8")])),
    lambda file, name, _: _replace(file, name, data=h5py.Empty("f8")),
    lambda file, name, _: _replace(file, name, shape=(10**6, 10**6), dtype="f8", chunks=(1, 1000)),
    lambda file, name, _: _replace(
        file, name, shape=(10**12,), dtype="f8", chunks=(10**6,), compression="gzip"
    ),
    lambda file, name, _: _replace(file, name, data=np.zeros(5), compression="gzip"),
    lambda file, name, _: _replace(file, name, data=np.zeros((2, 3, 4, 5))),
    lambda file, name, _: _replace(file, name, data=np.zeros(0)),
    lambda file, name, _: _replace(file, name, data=np.zeros((3, 2), "i4")),
    lambda file, _, __: file.create_group("/".join(["deep"] * 900)),
    lambda file, _, __: file.__setitem__("loop", file["/"]),
    lambda file, _, __: file.create_dataset("link", (1,), h5py.ref_dtype),
    lambda file, name, _: file.__setitem__("again", file[name]),
    lambda file, name, _: _fan_out(file),
    lambda file, name, _: None,
]
