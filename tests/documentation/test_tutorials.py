"""Pages do what they say: files, commands and programs are taken from them.

- A fence after a line that ends with `` `NAME`: `` is the content of that file.
- In a fence `console` each line that begins with `$ ` is a command. The lines below it are printed
  by it, in this order and perhaps among others.
- Fences `python` of a page are one program. The fence `text` after one is what it prints.

`...` stands for any text. Numbers may differ by a tenth, and what takes time by any factor.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sphrom

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def pages(folder: str) -> set[str]:
    """Return the pages of a folder, without their ending."""
    return {f"{folder}/{path.stem}" for path in (DOCS / folder).glob("*.md")}


FIRST = "tutorials/first-result"
MORE = ("tutorials/thousand-questions", "tutorials/notebook", "tutorials/hand-on")
GO_ON = (*MORE, *sorted(pages("python")))
"""Pages that go on in the folder of the first tutorial."""
CONTROL = "tutorials/control"
AFTER_CONTROL = "tutorials/measured-history"
"""The page that goes on in the folder of the tutorial on control."""
BY_THEMSELVES = ["index", *sorted(pages("tutorials") - {FIRST, *GO_ON, CONTROL, AFTER_CONTROL})]

FENCE = re.compile(r"(?:`(?P<file>[\w.-]+)`:\n\n)?```(?P<kind>\w+)\n(?P<body>.*?)```\n", re.DOTALL)
NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
TIMED = re.compile(
    r"(?:about )?[\d,.]+(?:e[-+]?\d+)?(?: \(.*\))? (?:s|ms|µs|minutes|hours|times|runs on)\b"
)
TOLERANCE = 0.1
SECONDS = 1500
"""What a command may take on a busy machine, kernels that have to be compiled included."""


def value(number: str) -> float:
    return float(number.replace(",", ""))


def agrees(shown: str, printed: str) -> bool:
    """Whether a printed line is as the page shows it."""
    shown, printed = (" ".join(TIMED.sub("TIME", line).split()) for line in (shown, printed))
    parts = [re.escape(part) for part in NUMBER.sub("NUMBER", shown).split("...")]
    pattern = ".*".join(parts).replace("NUMBER", f"({NUMBER.pattern})")
    found = re.fullmatch(pattern, printed)
    if found is None:
        return False
    pairs = zip(NUMBER.findall(shown), found.groups(), strict=True)
    return all(value(got) == pytest.approx(value(said), rel=TOLERANCE) for said, got in pairs)


def check_output(shown: list[str], printed: str) -> None:
    """Fail unless each shown line is printed, in order."""
    rest = iter(printed.splitlines())
    for line in filter(str.strip, shown):
        assert any(agrees(line, candidate) for candidate in rest), f"{line!r}\nnot in\n{printed}"


def run(command: list[str], folder: Path) -> str:
    """Return what a command prints; fail unless it ends well."""
    environment = {**os.environ, "PATH": f"{folder / 'bin'}:{os.environ['PATH']}"}
    environment |= {"PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=SECONDS
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


def follow(page: str, folder: Path) -> None:
    """Do what a page says, in a folder, and compare what it prints."""
    program, told = "", ""
    for fence in FENCE.finditer((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        body = fence["body"]
        if fence["file"]:
            (folder / fence["file"]).write_text(body, encoding="utf-8")
        elif fence["kind"] == "console":
            for command, *shown in (part.splitlines() for part in body.split("$ ")[1:]):
                check_output(shown, run(["bash", "-ec", command], folder))
        elif fence["kind"] == "python":
            program += body
        elif fence["kind"] == "text":
            told += body
    if program:
        check_output(told.splitlines(), run([sys.executable, "-c", program], folder))


def make_folder(folder: Path) -> Path:
    """Return a folder as that of a clone, with the command on its path."""
    for name in ("cases", "tests"):
        (folder / name).symlink_to(ROOT / name)
    command = folder / "bin" / "sphrom"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m sphrom "$@"\n')
    command.chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def after_the_first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which somebody followed the first tutorial."""
    folder = make_folder(tmp_path_factory.mktemp("first"))
    follow(FIRST, folder)
    return folder


def test_first_result(after_the_first: Path) -> None:
    assert (after_the_first / "runs" / "vortex" / "report.html").exists()


@pytest.mark.parametrize("page", GO_ON)
def test_pages_that_go_on(page: str, after_the_first: Path, tmp_path: Path) -> None:
    shutil.copytree(after_the_first, tmp_path / "copy", symlinks=True)
    follow(page, tmp_path / "copy")


@pytest.mark.parametrize("page", BY_THEMSELVES)
def test_pages_by_themselves(page: str, tmp_path: Path) -> None:
    follow(page, make_folder(tmp_path))


def test_control_and_a_measured_history(tmp_path: Path) -> None:
    folder = make_folder(tmp_path)
    follow(CONTROL, folder)
    follow(AFTER_CONTROL, folder)


def test_each_public_name_has_its_page() -> None:
    shown = "".join((DOCS / f"{page}.md").read_text("utf-8") for page in pages("python"))
    assert [name for name in sphrom.FROM_API if f":: sphrom.{name}" not in shown] == []
