"""Read YAML into plain values, with the line of every key.

By default, PyYAML reads `1e-5` as text, `1:30` as 90 and `no` as false, silently keeps the last of
two equal keys, and builds Python objects from tags. Here values follow the core rules of YAML 1.2,
equal keys and tags are refused, and the number of values is limited.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import yaml

from sphrom.text import quoted, shortened

Path = tuple[str | int, ...]
"""The keys and list indices that lead to a value."""
MAX_VALUES = 10_000
"""Largest number of values of one file; values of aliases count at each use."""
MAX_DEPTH = 20
_TAG = "tag:yaml.org,2002:"
_IMPLICIT = {
    "null": (r"~|null|Null|NULL|", ("~", "n", "N", "")),
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?[0-9][0-9_]*", "-+0123456789"),
    "float": (
        r"[-+]?(?:[0-9][0-9_]*(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+.0123456789",
    ),
}


@dataclass(frozen=True)
class Problem:
    """A problem of a case: the path of its key, the reason, and the line if it is not the key's."""

    path: Path
    reason: str
    line: int | None = None

    def __str__(self) -> str:
        return f"{show_path(self.path)}: {self.reason}" if self.path else self.reason


def show_path(path: Path) -> str:
    """Return a path in the form of --set, such as `rom.0.n_modes`."""
    return ".".join(
        shortened(str(segment), 60)
        if re.fullmatch(r"[\w-]+", str(segment), re.ASCII)
        else quoted(segment)
        for segment in path
    )


class _TooLarge(Exception):
    """A text nests too deeply or has too many values; the arguments are the reason and the line."""


class Loader(yaml.SafeLoader):
    """A loader of plain values by the rules of YAML 1.2, with limited nesting."""

    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML is configured by this attribute

    depth = n_nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self.depth += 1
        self.n_nodes += 1
        _require_small(self.depth, self.n_nodes // 2, self.line + 1)  # a value and its key
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class StoredLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """A loader of texts that `dump_yaml` wrote: in C, where there is such a loader."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012


class Dumper(yaml.SafeDumper):
    """A dumper that quotes texts which the loader would read as another type."""

    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML is configured by this attribute

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _class in (Loader, StoredLoader, Dumper):
    for _name, (_pattern, _first) in _IMPLICIT.items():
        _class.add_implicit_resolver(_TAG + _name, re.compile(f"(?:{_pattern})\\Z"), _first)


def _require_small(depth: int, n_values: int, line: int) -> None:
    if depth > MAX_DEPTH:
        raise _TooLarge(f"nests deeper than {MAX_DEPTH} levels", line)
    if n_values > MAX_VALUES:
        raise _TooLarge(f"has more than {MAX_VALUES} values", line)


def dump_yaml(value: Any) -> str:
    """Return plain values as YAML that `read_yaml` can read."""
    return yaml.dump(value, Dumper=Dumper, sort_keys=False, width=100)


def read_yaml(text: str, loader: type[Loader | StoredLoader] = Loader) -> Document:
    """Read one YAML document; its errors are in `problems`."""
    line = None
    document = Document()
    try:
        if (node := loader(text).get_single_node()) is not None:
            document.value = document.convert(node, ())
        return document
    except _TooLarge as error:
        reason, line = error.args
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        words = error.problem or error.context or "can't be read"
        reason = f"not valid YAML: {words}"
        line = mark and mark.line + 1
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        reason = f"not valid YAML: character #x{int(error.character):04x} is not allowed"
    except (ValueError, OverflowError):  # an escape beyond the last character
        reason = "not valid YAML: an escaped character does not exist"
    return Document(problems=[Problem((), reason, line)])


@dataclass
class Document:
    """The content of a YAML text."""

    value: Any = None
    lines: dict[Path, int] = field(default_factory=dict)
    """The line of each key and list entry, counted from 1."""
    problems: list[Problem] = field(default_factory=list)
    n_values: int = 0
    """Number of values so far; values of aliases count at each use."""

    def convert(self, node: yaml.Node, path: Path) -> Any:
        """Return a node as plain values."""
        line = node.start_mark.line + 1
        self.lines.setdefault(path, line)
        self.n_values += 1
        _require_small(len(path), self.n_values, line)
        kind = node.tag.removeprefix(_TAG)
        if isinstance(node, yaml.MappingNode) and kind == "map":
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode) and kind == "seq":
            return [self.convert(item, (*path, i)) for i, item in enumerate(node.value)]
        if isinstance(node, yaml.ScalarNode) and kind == "str":
            return str(node.value)
        if kind not in _IMPLICIT or not re.fullmatch(_IMPLICIT[kind][0], str(node.value)):
            return self._refuse(path, line, f"tags are not allowed; got {node.tag}")
        text = str(node.value).replace("_", "").lower()
        if kind in ("null", "bool"):
            return None if kind == "null" else text == "true"
        try:
            return int(text) if kind == "int" else float(re.sub(r"\.(?=inf|nan)", "", text))
        except ValueError:  # Python limits the digits of integers
            return self._refuse(path, line, "a number of too many digits")

    def _mapping(self, node: yaml.MappingNode, path: Path) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = key_node.value
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                self._refuse(path, line, "a key must be text")
            elif key in values:
                first = self.lines[(*path, key)]
                self._refuse((*path, key), line, f"appears twice, first in line {first}")
            else:
                self.lines[(*path, key)] = line
                values[key] = self.convert(value_node, (*path, key))
        return values

    def _refuse(self, path: Path, line: int, reason: str) -> None:
        self.problems.append(Problem(path, reason, line))
