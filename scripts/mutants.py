"""Change one thing at a time in a copy of the program, and see whether a test notices.

What is changed is drawn by seed: signs, numbers by a few per cent, indices, comparisons,
conditions, terms, statements, arguments that are left out. Text, messages and annotations are left
alone. The tests of a change are those that mirror its module's path, then those that import it, the
nearest first. Each process of tests has a copy of its own, and first makes sure that Python finds
it. A failure, be it to load tests, counts if they pass without the change; others are left out.

    python scripts/mutants.py --count 150 --seed 1 --jobs 2
    python scripts/mutants.py --count 20 --seed 7 --package kernels

The last lines name what survived: a missing test, or a change that makes no difference.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib.util
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict, deque
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
COPIED = ("cases", "docs", "scripts", "sphrom", "tests")
"""Folders that the program and its tests need."""
MOST_FILES = 15
"""Test files that a change is shown to."""
HANGS = 120
"""Seconds after which one test hangs."""
NOT_COPY = 99
"""The exit code where Python doesn't find the copy."""
WITHIN = "--within"
"""The first argument of a process of tests."""
Outcome = tuple[int | None, dict[str, str]]
"""Pytest's exit code, None if time ran out, and its word for tests and files, "" if it crashed."""
RESULT = r"^(tests/\S+?::.*?) (?:(PASSED|FAILED|ERROR|SKIPPED|XFAIL|XPASS)\b.*)?$"
NOT_LOADED = r"^ERROR (tests/\S+?\.py)(?: - .*)?$"
FAILURES = ("FAILED", "ERROR", "")
NO_TESTS = 5
"""The exit code where all are left out."""
SPEAKS = {
    "info", "warn", "table", "progress", "print", "Option", "Argument", "key", "Typer", "TypeVar",
    "reshape",
}  # fmt: skip
"""Calls whose text is for readers, or whose -1 is any number: their first argument is enough."""
NO_DIFFERENCE = {
    "strict", "help", "description", "title", "encoding", "newline", "metadata", "exist_ok",
    "parents", "stacklevel", "cache", "nogil", "error_model", "fastmath", "parallel", "dpi",
    "fontsize", "figsize", "linewidth", "alpha", "color", "markersize", "flush", "advance",
    "timeout", "default_flow_style", "allow_unicode", "copy", "init", "repr", "compare", "bound",
    "full_matrices", "check_finite", "overwrite_a", "optimize", "daemon",
}  # fmt: skip
"""Arguments that results don't depend on."""
LOOKS = {"plots", "report", "cli"}
"""Packages whose numbers are widths, sizes and places on a page."""
OPPOSITE = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn,
    ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
COMPILING = {"jit", "code_cache"}
"""Modules among the kernels that compile, and have no loops themselves."""
COMPILED_TESTS = {"pipeline", "verification"}
"""Tests that take too long with kernels in plain Python."""
NEXT_TO = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}


@dataclass(frozen=True)
class Change:
    """One piece of source and what stands there instead."""

    path: Path
    kind: str
    line: int
    span: tuple[int, int] = field(repr=False)
    """First byte, and the first one after it."""
    old: str
    new: str

    def __str__(self) -> str:
        old, new = (" ".join(text.split()) for text in (self.old, self.new))
        return f"{self.path}:{self.line}: {self.kind}: {old[:90]}  ->  {new[:90]}"

    def applied(self, source: bytes) -> bytes:
        """Return the source with the change."""
        if source[slice(*self.span)] != self.old.encode():
            raise RuntimeError(f"{self.path} has changed since the changes were drawn; start again")
        return source[: self.span[0]] + self.new.encode() + source[self.span[1] :]


class Finder:
    """All changes that one module offers."""

    def __init__(self, path: Path, factor: random.Random) -> None:
        self._path, self._random = path, factor
        self._source = (ROOT / path).read_bytes()
        self._starts = [0]
        for line in self._source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self.changes: list[Change] = []
        self._visit(ast.parse(self._source))

    def _offer(self, kind: str, node: ast.expr | ast.stmt, new: ast.AST | str) -> None:
        assert node.end_lineno is not None and node.end_col_offset is not None  # noqa: PT018
        first = self._starts[node.lineno - 1] + node.col_offset
        last = self._starts[node.end_lineno - 1] + node.end_col_offset
        text = new if isinstance(new, str) else f"({ast.unparse(new)})"
        old = self._source[first:last].decode()
        self.changes.append(Change(self._path, kind, node.lineno, (first, last), old, text))

    def _visit(self, node: ast.AST) -> None:
        """Offer the changes of a node and of what it holds, but for text and annotations."""
        if isinstance(node, (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom)):
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        if isinstance(node, ast.Call) and _name(node.func) in SPEAKS:
            for argument in node.args[:1]:
                self._visit(argument)
            return
        getattr(self, f"_{type(node).__name__.lower()}", lambda _: None)(node)
        for name, value in ast.iter_fields(node):
            if name in {"annotation", "returns", "decorator_list", "type_params", "bases"}:
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.keyword) and child.arg in NO_DIFFERENCE:
                    continue
                if isinstance(child, ast.AST):
                    self._visit(child)

    def _binop(self, node: ast.BinOp) -> None:
        if any(isinstance(side, (ast.JoinedStr, ast.List, ast.Tuple))
               or isinstance(getattr(side, "value", None), (str, bytes))
               for side in (node.left, node.right)):  # fmt: skip
            return
        if isinstance(node.op, ast.Div) and re.search("path|folder", ast.unparse(node.left), re.I):
            return
        if isinstance(node.op, (ast.Add, ast.Sub)):
            self._offer("term dropped", node, node.left)
        if type(node.op) in OPPOSITE:
            self._offer("operator", node, _with(node, op=OPPOSITE[type(node.op)]()))
        if isinstance(node.op, (ast.Mult, ast.Div)) and not LOOKS & set(self._path.parts):
            factor = ast.Constant(self._factor())
            self._offer("factor", node, ast.BinOp(factor, ast.Mult(), node))

    def _factor(self) -> float:
        return round(1.0 + self._random.choice((-1, 1)) * self._random.uniform(0.01, 0.05), 3)

    def _unaryop(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, (ast.USub, ast.Not)):
            self._offer("sign", node, node.operand)

    def _boolop(self, node: ast.BoolOp) -> None:
        self._offer("condition", node, _with(node, op=OPPOSITE[type(node.op)]()))

    def _compare(self, node: ast.Compare) -> None:
        op = type(node.ops[0])
        if len(node.ops) > 1 or op not in OPPOSITE:
            return
        self._offer("comparison", node, _with(node, ops=[OPPOSITE[op]()]))
        # Among reals, "less" and "at most" are one.
        if op in NEXT_TO and any(map(_counts, (node.left, node.comparators[0]))):
            self._offer("comparison", node, _with(node, ops=[NEXT_TO[op]()]))

    def _if(self, node: ast.If | ast.IfExp) -> None:
        if not isinstance(node.test, (ast.Compare, ast.BoolOp, ast.UnaryOp)):
            self._offer("condition", node.test, ast.UnaryOp(ast.Not(), node.test))

    _ifexp = _if

    def _constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool):
            self._offer("default", node, str(not node.value))
        elif isinstance(node.value, (int, float)) and not LOOKS & set(self._path.parts):
            if isinstance(node.value, float) and node.value != 0.0:
                self._offer("number", node, repr(float(f"{node.value * self._factor():.6g}")))
            else:
                self._offer("number", node, repr(node.value + 1))

    def _subscript(self, node: ast.Subscript) -> None:
        if isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, int):
            other = _with(node, slice=ast.Constant(1 - min(1, node.slice.value)))
            self._offer("index", node, ast.unparse(other))

    def _expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call) and _name(node.value.func) not in SPEAKS:
            self._offer("statement dropped", node, "pass")

    def _augassign(self, node: ast.AugAssign) -> None:
        self._offer("statement dropped", node, "pass")

    def _call(self, node: ast.Call) -> None:
        for place, keyword in enumerate(node.keywords):
            if keyword.arg and keyword.arg not in NO_DIFFERENCE:
                rest = node.keywords[:place] + node.keywords[place + 1 :]
                self._offer("argument dropped", node, _with(node, keywords=rest))


def _with(node: ast.AST, **changes: object) -> ast.AST:
    other = deepcopy(node)
    for name, value in changes.items():
        setattr(other, name, value)
    return other


def _name(function: ast.expr) -> str:
    return ast.unparse(function).rpartition(".")[2]


def _counts(node: ast.expr) -> bool:
    """Return whether an expression is a whole number as far as can be seen."""
    text = ast.unparse(node)
    return (isinstance(node, ast.Constant) and type(node.value) is int) or bool(
        re.match(r"len\(|n_\w+$|count$", text) or text.endswith((".size", ".shape[0]"))
    )


def draw(seed: int, count: int, package: str | None) -> list[Change]:
    """Draw changes over all packages, and over all kinds in a package."""
    chance = random.Random(seed)
    offered: dict[str, dict[str, list[Change]]] = defaultdict(lambda: defaultdict(list))
    for path in sorted((ROOT / "sphrom").rglob("*.py")):
        relative = path.relative_to(ROOT)
        where = relative.parts[1] if len(relative.parts) > 2 else "top"
        if package in (None, where):
            for change in Finder(relative, chance).changes:
                offered[where][change.kind].append(change)
    if not offered:
        raise SystemExit(f"no package {package} in sphrom")
    drawn: list[Change] = []
    while len(drawn) < count and offered:
        names = list(offered)
        weights = [sum(map(len, offered[name].values())) ** 0.5 for name in names]
        name = chance.choices(names, weights)[0]
        kind = chance.choice(list(offered[name]))
        choices = offered[name][kind]
        drawn.append(choices.pop(chance.randrange(len(choices))))
        if not choices:
            del offered[name][kind]
        if not offered[name]:
            del offered[name]
    return drawn


class Tests:
    """Which tests belong to a module: by its path, then by what they import."""

    def __init__(self) -> None:
        sources = sorted((ROOT / "sphrom").rglob("*.py"))
        modules = {_module(path.relative_to(ROOT)): path for path in sources}
        self._names = set(modules)
        self._imports = {name: set(self._imported(path)) for name, path in modules.items()}
        self._tests = {
            path: set(self._imported(path)).union(
                *(self._imported(c) for f in path.parents if (c := f / "conftest.py").exists())
            )
            for path in sorted((ROOT / "tests").rglob("test_*.py"))
        }

    def _imported(self, path: Path) -> Iterator[str]:
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                yield from (a.name for a in node.names if a.name in self._names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                parts = {f"{node.module}.{alias.name}" for alias in node.names} & self._names
                yield from parts or ({node.module} & self._names)
            elif isinstance(node, ast.Constant) and path == ROOT / "sphrom/stages.py":
                # Stages are loaded by their names.
                yield from {f"sphrom.{node.value!s}"} & self._names

    def of(self, path: Path) -> list[str]:
        """Return the test files of a module, those that know most of it first."""
        module, plain = _module(path), is_plain(path)
        importers = defaultdict(set)
        for name, imported in self._imports.items():
            for other in imported:
                importers[other].add(name)
        distance, queue = {module: 0}, deque([module])
        while queue:
            for importer in importers[nearest := queue.popleft()]:
                if importer not in distance:
                    distance[importer] = distance[nearest] + 1
                    queue.append(importer)
        users = {name.split(".")[1] for name in importers[module] if "." in name}
        words = set(path.stem.strip("_").split("_"))
        ranked = []
        for test, imported in self._tests.items():
            near_ones = [distance[name] for name in imported if name in distance]
            own = test.stem.removeprefix("test_")
            mirrors = own == path.stem.strip("_")
            folder = test.parent.name
            if not (near_ones or mirrors) or (plain and folder in COMPILED_TESTS):
                continue
            apart = min(near_ones, default=0)
            same_words = -len(words & set(own.split("_")))
            near = folder == path.parent.name
            # Those of the command line put recorders in the place of stages.
            slow = 0 if near else {"verification": 2, "cli": 2, "pipeline": 1}.get(folder, 0)
            used = folder in users
            rank = (not mirrors, min(apart, 2), same_words, slow, not near, not used, apart)
            ranked.append((rank, test.relative_to(ROOT).as_posix()))
        return [test for _, test in sorted(ranked)[:MOST_FILES]]


def is_plain(path: Path) -> bool:
    """Return whether a module is run as plain Python: compiling it takes longer than its tests."""
    return "kernels" in path.parts and path.stem not in COMPILING


def _module(path: Path) -> str:
    """Return the name of a module, whose path begins at the root."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


class Laboratory:
    """Runs tests on copies of the program, most of which have one thing changed."""

    def __init__(self, scratch: Path, cache: Path, limit: float) -> None:
        self._scratch, self._cache, self._limit = scratch.resolve(), cache.resolve(), limit
        self._controls: dict[tuple[str, bool], Outcome] = {}
        self._left_out: set[tuple[str, bool]] = set()
        self._tree = self._scratch / "unchanged"
        self._tree.mkdir()
        for path in ROOT.iterdir():
            if path.name in COPIED:
                shutil.copytree(path, self._tree / path.name, symlinks=True)
            elif path.is_file() and not path.name.startswith("."):
                shutil.copy2(path, self._tree)

    def judge(self, change: Change, tests: list[str]) -> tuple[str, str]:
        """Return `killed`, `survived` or `out of time`, and the test that noticed."""
        plain, left = is_plain(change.path), self._limit
        # Most changes fall to the first file: the others needn't even be loaded.
        for group in (tests[:1], tests[1:3], tests[3:]):
            while files := [test for test in group if (test, plain) not in self._left_out]:
                start = time.monotonic()
                code, results = self._run(files, plain, left, change)
                left -= time.monotonic() - start
                if code in (0, NO_TESTS):
                    break
                failed = next((name for name in results if results[name] in FAILURES), "")
                if code is None and not failed:
                    return "out of time", ""
                if self._passes_unchanged(failed, files, plain):
                    return "killed", failed or "collection"
        return "survived", ""

    def _passes_unchanged(self, failed: str, files: list[str], plain: bool) -> bool:
        """Return whether what failed (all files if unknown) passes unchanged, or leave it out."""
        passes = True
        for name in [failed] if failed else files:
            file = name.partition("::")[0]
            if (file, plain) not in self._controls:
                self._controls[file, plain] = self._run([file], plain, 2.0 * self._limit, None)
            code, results = self._controls[file, plain]
            words = results.values()
            ended = code in (0, 1) and "PASSED" in words and "" not in words
            if results.get(name, "PASSED" if ended else "") != "PASSED":
                passes = False
                doubtful = name if "PASSED" in words else file
                self._left_out.add((doubtful, plain))
                print(f"left out: {doubtful}: it was not seen to pass without a change", flush=True)
        return passes

    def _run(self, tests: list[str], plain: bool, limit: float, change: Change | None) -> Outcome:
        """Run tests in a process of their own, over a copy of their own."""
        path = change.path if change else Path("sphrom/__init__.py")
        with tempfile.TemporaryDirectory(dir=self._scratch, ignore_cleanup_errors=True) as folder:
            tree, home, output = (Path(folder) / name for name in ("tree", "home", "output"))
            home.mkdir()
            shutil.copytree(self._tree, tree, symlinks=True)
            if change:
                (tree / path).write_bytes(change.applied((tree / path).read_bytes()))
                # Bytecode is taken for its source if size and second are the same.
                Path(importlib.util.cache_from_source(tree / path)).unlink(missing_ok=True)
            options = [
                "-vv", "--tb=no", "-p", "no:cacheprovider", "--rootdir=.",
                "-o", "addopts=--import-mode=importlib", *(["-x"] if change else []),
                *(f"--deselect={test}" for test, how in list(self._left_out) if how == plain),
                "-o", f"faulthandler_timeout={HANGS}", "-o", "faulthandler_exit_on_timeout=true",
            ]  # fmt: skip
            environment = os.environ | {
                "PYTHONPATH": str(tree),
                "PYTHONDONTWRITEBYTECODE": "1",
                "NUMBA_DISABLE_JIT": str(int(plain)),
                # Kernels from a changed compiler are thrown away.
                "SPHROM_CACHE": str(home if "kernels" in path.parts else self._cache),
                "MPLCONFIGDIR": str(self._cache / "matplotlib"),
                "MPLBACKEND": "agg",
                "PYTEST_ADDOPTS": "",
                **dict.fromkeys(("HOME", "TMPDIR"), str(home)),
            }
            command = [sys.executable, "-P", __file__, WITHIN, str(path), *options, *tests]
            with output.open("wb") as stdout:
                code = _exit_code(command, limit, stdout=stdout, cwd=tree, env=environment)
            text = output.read_text(encoding="utf-8", errors="replace")
        if code == NOT_COPY:
            raise RuntimeError(text.strip())
        ran = {name: word for name, word in re.findall(RESULT, text, re.M) if word or code}
        return code, ran | dict.fromkeys(re.findall(NOT_LOADED, text, re.M), "ERROR")


def _exit_code(command: list[str], limit: float, **options: Any) -> int | None:
    """Return the exit code of a process, or None if it had to be killed; it leaves no others."""
    options |= {"stdin": subprocess.PIPE, "stderr": subprocess.DEVNULL, "start_new_session": True}
    with subprocess.Popen(command, **options) as process:
        try:
            return process.wait(limit)
        except subprocess.TimeoutExpired:
            return None
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def run_within(changed: str, *arguments: str) -> int:
    """Run tests in this process, in a copy, if that is what Python finds; end with the parent."""
    threading.Thread(target=_end_with, args=(os.dup(0),), daemon=True).start()
    for path in (Path("sphrom/__init__.py"), Path(changed)):
        spec = importlib.util.find_spec(_module(path))
        found = spec.origin if spec else None
        if found != str(path.absolute()):
            print(f"{_module(path)} is loaded from {found}, not from the copy's {path}")
            return NOT_COPY
    return int(importlib.import_module("pytest").main([*arguments]))


def _end_with(pipe: int) -> None:
    os.read(pipe, 1)
    os.killpg(0, signal.SIGKILL)


def main() -> None:
    """Draw, judge, and name what survived."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seed", type=int, default=random.randrange(10**6))
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--package", help="such as kernels; all by default")
    parser.add_argument("--limit", type=float, default=240.0, help="seconds for one change's tests")
    parser.add_argument("--jobs", type=int, default=1, help="changes at a time")
    parser.add_argument("--list", action="store_true", help="draw and print, without a test")
    parser.add_argument("--folder", type=Path, help="keeps the compiled kernels")
    asked = parser.parse_args()
    drawn = draw(asked.seed, asked.count, asked.package)
    print(f"seed {asked.seed}: {len(drawn)} changes", flush=True)
    if asked.list:
        print(*drawn, sep="\n")
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    os.makedirs(asked.folder or tempfile.gettempdir(), exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(dir=asked.folder, ignore_cleanup_errors=True) as scratch:
            kept = asked.folder or Path(scratch)
            judge_all(drawn, Laboratory(Path(scratch), kept / "cache", asked.limit), asked.jobs)
    except RuntimeError as error:
        raise SystemExit(str(error)) from None


def judge_all(drawn: list[Change], laboratory: Laboratory, jobs: int) -> None:
    """Print a line for each change, and at the end those that no test noticed."""
    tests = Tests()
    killed, alive = 0, []

    def judge(change: Change) -> tuple[str, str, float]:
        start = time.monotonic()
        state, test = laboratory.judge(change, tests.of(change.path))
        return state, f"{change}  [{test or state}]", time.monotonic() - start

    try:
        with ThreadPool(jobs) as pool:
            for state, line, seconds in pool.imap_unordered(judge, drawn):
                print(f"{state:11} {seconds:4.0f} s  {line}", flush=True)
                if state == "killed":
                    killed += 1
                else:
                    alive.append(line)
    finally:
        print(f"\n{killed} of {killed + len(alive)} killed", *alive, sep="\n", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == [WITHIN]:
        sys.exit(run_within(*sys.argv[2:]))
    main()
