"""Every key of a case file, as Markdown tables, from the schema that checks cases."""

from collections.abc import Iterator, Mapping
from typing import Any

from sphrom.case import schema
from sphrom.case.models import Case
from sphrom.case.scenes import DEFAULTS
from sphrom.case.yaml_reader import dump_yaml

Node = Mapping[str, Any]
NAMED = "NAME"
"""Stands in a path for a key that the case names."""


def markdown() -> str:
    """Return a section for each mapping of the case file, in the order of the file."""
    root = schema.json_schema()
    lines = ["## The case", "", *_table(root, ())]
    seen: set[str] = set()
    for key, node in root["properties"].items():
        sections = list(_sections(node, (key,), seen))
        lines += (
            ["", f"## `{key}`", "", _sentence(node["description"]), *sections] if sections else []
        )
    return "\n".join(lines) + "\n"


def _sections(node: Node, path: tuple[str, ...], seen: set[str]) -> Iterator[str]:
    """Yield a section for each definition that a node leads to and that has none yet."""
    for at, name in _definitions(node, path):
        if name in seen:
            continue
        seen.add(name)
        section = schema.json_schema()["$defs"][name]
        kind = section["properties"].get("kind", {}).get("const")
        if kind or len(at) > 1:
            named = f" of kind `{kind}`" if kind else ""
            yield from ("", f"### `{'.'.join(at)}`{named}", "", section["description"])
        yield ""
        yield from _table(section, at)
        for key, child in section["properties"].items():
            yield from _sections(child, (*at, key), seen)


def _definitions(node: Node, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    if "$ref" in node:
        yield path, node["$ref"].rsplit("/", 1)[1]
    for branch in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        yield from _definitions(branch, path)
    if "items" in node:
        yield from _definitions(node["items"], (*path[:-1], f"{path[-1]}[]"))
    for named in node.get("patternProperties", {}).values():
        yield from _definitions(named, (*path, NAMED))


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _table(section: Node, path: tuple[str, ...]) -> Iterator[str]:
    yield from ("| key | default | unit | |", "|---|---|---|---|")
    required = section.get("required", ())
    for key, node in section["properties"].items():
        default = "required" if key in required else _default(node, (*path, key))
        yield f"| `{key}` | {default} | {_unit(node)} | {_text(node)} |"


def _unit(node: Node) -> str:
    unit = node.get("unit", "")
    return unit if unit != "-" else "–"


def _text(node: Node) -> str:
    text = str(node.get("description", ""))
    if not schema.is_section(node):
        text += f"; {schema.allowed(node)}"
    return text.replace("|", "\\|").replace("<", "\\<").replace("*", "\\*")


def _default(node: Node, path: tuple[str, ...]) -> str:
    if schema.is_section(node) and node.get("default") is None and not _by_scene(path):
        return "below" if "default" not in node else "`null`"
    if "default" in node:
        return _short(node["default"])
    values = _by_scene(path)
    if len(set(values.values())) == 1:
        return next(iter(values.values()))
    return ", ".join(f"{value} ({kind})" for kind, value in values.items())


def _by_scene(path: tuple[str, ...]) -> dict[str, str]:
    """Return the default of a key that depends on the kind of scene."""
    found = {}
    for kind in DEFAULTS:
        value: Any = Case.model_validate({"name": "x", "scene": {"kind": kind}}).model_dump(
            mode="json"
        )
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        if not isinstance(value, dict) and value is not None:
            found[kind] = _short(value)
    return found


def _short(value: Any) -> str:
    if isinstance(value, dict) and value:
        return "below"
    if isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        return "below"
    if isinstance(value, list):
        return f"`[{', '.join(_plain(entry) for entry in value)}]`"
    return f"`{_plain(value)}`"


def _plain(value: Any) -> str:
    return "{}" if value == {} else dump_yaml(value).removesuffix("...\n").strip()
