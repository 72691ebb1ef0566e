"""Change one thing at a time in a copy of the program, and see whether a test notices.

What is changed is drawn by seed: signs, numbers by a few per cent, indices, comparisons,
conditions, terms, statements, arguments that are left out. Text, messages and annotations are left
alone. The tests of a change are those that mirror its module's path, then those that import it, the
nearest first; they stop at the first failure, which counts if it passes without the change.

    python scripts/mutants.py --count 150 --seed 1
    python scripts/mutants.py --count 20 --seed 7 --package kernels

The last lines name what survived: a missing test, or a change that makes no difference.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
from collections import defaultdict, deque
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import NoReturn

import pytest

from sphrom.stages import STAGES

ROOT = Path(__file__).resolve().parent.parent
MOST_FILES = 15
"""Test files that a change is shown to."""
HANGS = 120
"""Seconds after which one test hangs."""
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
LIBRARIES = (
    "numpy", "scipy.linalg", "scipy.sparse.linalg", "scipy.special", "scipy.ndimage", "numba",
    "h5py", "pydantic", "typer.testing", "yaml", "rich.progress", "hypothesis.extra.numpy",
    "matplotlib.pyplot",
)  # fmt: skip
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
        if any(isinstance(side, (ast.JoinedStr, ast.List, ast.Tuple)) or _is_text(side)
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

    def _dict(self, node: ast.Dict) -> None:
        """Leave tables alone: their text is what they say."""


def _with(node: ast.AST, **changes: object) -> ast.AST:
    other = deepcopy(node)
    for name, value in changes.items():
        setattr(other, name, value)
    return other


def _name(function: ast.expr) -> str:
    return ast.unparse(function).rpartition(".")[2]


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes))


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
        self._names = {_module(path) for path in sources}
        self._imports = {_module(path): set(self._imported(path)) for path in sources}
        # Stages are loaded by their names.
        self._imports["sphrom.stages"] |= {f"sphrom.{name}" for name in STAGES.values()}
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

    def of(self, path: Path) -> list[str]:
        """Return the test files of a module, those that know most of it first."""
        module, plain = _module(ROOT / path), is_plain(path)
        importers = defaultdict(set)
        for name, imported in self._imports.items():
            for other in imported:
                importers[other].add(name)
        distance, queue = {module: 0}, deque([module])
        while queue:
            for importer in importers[near := queue.popleft()]:
                if importer not in distance:
                    distance[importer] = distance[near] + 1
                    queue.append(importer)
        users = {name.split(".")[1] for name in importers[module] if "." in name}
        words = set(path.stem.strip("_").split("_"))
        ranked = []
        for test, imported in self._tests.items():
            apart = min((distance[name] for name in imported if name in distance), default=None)
            own = test.stem.removeprefix("test_")
            mirrors = own == path.stem.strip("_")
            folder = test.parent.name
            if (apart is None and not mirrors) or (plain and folder in COMPILED_TESTS):
                continue
            same_words = -len(words & set(own.split("_")))
            near = folder == path.parent.name
            # Those of the command line put recorders in the place of stages.
            slow = 0 if near else {"verification": 2, "cli": 2, "pipeline": 1}.get(folder, 0)
            used = folder in users
            rank = (
                not mirrors,
                min(apart or 0, 2),
                same_words,
                slow,
                not near,
                not used,
                apart or 0,
            )
            ranked.append((rank, test.relative_to(ROOT).as_posix()))
        return [test for _, test in sorted(ranked)[:MOST_FILES]]


def is_plain(path: Path) -> bool:
    """Return whether a module is run as plain Python: compiling it takes longer than its tests."""
    return "kernels" in path.parts and path.stem not in COMPILING


def _module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@dataclass(frozen=True)
class Verdict:
    """What the tests said."""

    state: str
    """`killed`, `survived`, or `out of time` where there were more tests than time."""
    by: str = ""
    """The test that noticed."""


class Laboratory:
    """A copy of the tree, in which one thing is changed at a time."""

    def __init__(self, folder: Path, limit: float) -> None:
        self._tree, self._limit = folder / "tree", limit
        self._trusted: set[tuple[str, bool]] = set()
        self._left_out: set[tuple[str, bool]] = set()
        names = ["sphrom", "tests", "cases", "scripts", *(p.name for p in ROOT.glob("*.*"))]
        for name in filter(lambda name: (ROOT / name).exists(), names):
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
            options = {"dirs_exist_ok": True} if copy is shutil.copytree else {}
            copy(ROOT / name, self._tree / name, **options)  # type: ignore[operator]
        self._environment = os.environ | {
            "PYTHONPATH": str(self._tree),
            "PYTHONDONTWRITEBYTECODE": "1",
            "SPHROM_CACHE": str(folder / "cache"),
            "MPLBACKEND": "agg",
        }
        self._environment.pop("NUMBA_CACHE_DIR", None)
        # Children are forked, so that each has the libraries without loading them.
        for library in LIBRARIES:
            import_module(library)

    def judge(self, change: Change, tests: list[str]) -> Verdict:
        """Run the tests on a change, and the one that fails without it."""
        plain = is_plain(change.path)
        deadline = time.monotonic() + self._limit
        verdict = Verdict("survived")
        # Most changes fall to the first file: the others needn't even be loaded.
        for group in filter(None, (tests[:1], tests[1:3], tests[3:])):
            verdict = self._shown_to(group, change, plain, deadline)
            if verdict.state != "survived":
                break
        return verdict

    def _shown_to(self, tests: list[str], change: Change, plain: bool, deadline: float) -> Verdict:
        """Run tests on a change until one fails that doesn't fail without it."""
        while True:
            with self._changed(change):
                code, failed = self._run(tests, plain, deadline - time.monotonic())
            if code in (0, NO_TESTS):
                return Verdict("survived")
            if not failed:
                return Verdict("out of time") if code is None else Verdict("killed", "collection")
            if self._fails_for_it(failed, plain):
                return Verdict("killed", failed)

    def _fails_for_it(self, failed: str, plain: bool) -> bool:
        """Return whether a test passes without a change, or others of its file were seen to."""
        file = failed.partition("::")[0], plain
        if file not in self._trusted:
            if self._run([failed], plain, HANGS)[0] != 0:
                self._left_out.add((failed, plain))
                return False
            self._trusted.add(file)
        return True

    @contextlib.contextmanager
    def _changed(self, change: Change) -> Iterator[None]:
        """Change the copy for a while."""
        target = self._tree / change.path
        source, times = target.read_bytes(), target.stat()
        target.write_bytes(change.applied(source))
        try:
            yield
        finally:
            target.write_bytes(source)
            # Compiled kernels are kept for a file as old as it was.
            os.utime(target, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _run(self, tests: list[str], plain: bool, limit: float) -> tuple[int | None, str]:
        """Return pytest's exit code, None if time ran out, and the test that failed or hung."""
        options = [
            "-x", "-vv", "--tb=no", "-p", "no:cacheprovider",
            "-o", "addopts=--import-mode=importlib",
            *(f"--deselect={test}" for test, how in sorted(self._left_out) if how == plain),
            "-o", f"faulthandler_timeout={HANGS}", "-o", "faulthandler_exit_on_timeout=true",
        ]  # fmt: skip
        with tempfile.TemporaryFile() as output:
            child = os.fork()
            if not child:
                self._become_pytest([*options, *tests], plain, output.fileno())
            code = _waited(child, limit)
            output.seek(0)
            text = output.read().decode(errors="replace")
        failed = re.search(r"^(tests/\S+?::.+?) (?:FAILED|ERROR)", text, re.MULTILINE)
        if failed is None and code is not None and "Timeout (" in text:
            failed = re.search(r"^(tests/\S+?::.+?) (?!PASSED|SKIPPED)\S*Timeout", text, re.M)
        return code, failed.group(1) if failed else ""

    def _become_pytest(self, arguments: list[str], plain: bool, output: int) -> NoReturn:
        """Run tests in this process, which is a child, over the copy's sources, and end."""
        os.setsid()
        for stream in (1, 2):
            os.dup2(output, stream)
        os.environ.clear()
        os.environ.update(self._environment | ({"NUMBA_DISABLE_JIT": "1"} if plain else {}))
        sys.modules["numba"].config.reload_config()  # type: ignore[attr-defined]
        os.chdir(self._tree)
        scripts = str(ROOT / "scripts")
        sys.path[:] = [str(self._tree), *(p for p in sys.path if p not in (scripts, str(ROOT)))]
        try:
            code = int(pytest.main(arguments))
            sys.stdout.flush()
        finally:
            os._exit(code)


def _waited(child: int, limit: float) -> int | None:
    """Return the exit code of a process, or None if it had to be killed; it leaves no others."""
    deadline, code = time.monotonic() + limit, None
    while code is None and time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        code = os.waitstatus_to_exitcode(status) if done else None
        time.sleep(0.05)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if code is None:
        os.waitpid(child, 0)
    return code


def main() -> None:
    """Draw, judge, and name what survived."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seed", type=int, default=random.randrange(10**6))
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--package", help="such as kernels; all by default")
    parser.add_argument("--limit", type=float, default=240.0, help="seconds for one change's tests")
    parser.add_argument("--list", action="store_true", help="draw and print, without a test")
    parser.add_argument("--folder", type=Path, help="keeps the copy and its compiled kernels")
    asked = parser.parse_args()
    drawn = draw(asked.seed, asked.count, asked.package)
    print(f"seed {asked.seed}: {len(drawn)} changes", flush=True)
    if asked.list:
        print(*drawn, sep="\n")
        return
    with tempfile.TemporaryDirectory() as scratch:
        judge_all(drawn, Laboratory(asked.folder or Path(scratch), asked.limit))


def judge_all(drawn: list[Change], laboratory: Laboratory) -> None:
    """Print a line for each change, and at the end those that no test noticed."""
    tests, alive = Tests(), []
    for change in drawn:
        start = time.monotonic()
        verdict = laboratory.judge(change, tests.of(change.path))
        seconds = time.monotonic() - start
        print(f"{verdict.state:11} {seconds:4.0f} s  {change}  [{verdict.by}]", flush=True)
        if verdict.state != "killed":
            alive.append(f"{change}  [{verdict.by or verdict.state}]")
    killed = len(drawn) - len(alive)
    print(
        f"\n{killed} of {len(drawn)} killed, {100.0 * killed / len(drawn):.1f} %", *alive, sep="\n"
    )


if __name__ == "__main__":
    main()
