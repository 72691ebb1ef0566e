"""Recipes with other programs do what their page shows; one is skipped without its program."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tests.documentation.test_tutorials import DOCS, FENCE, check_output, make_folder, run

pytestmark = pytest.mark.slow
PREPARED, *PARTS = re.split(r"^## ", (DOCS / "recipes.md").read_text(encoding="utf-8"), flags=re.M)
PACKAGES = {"scipy": "scipy", "SALib": "SALib", "OpenTURNS": "openturns", "UM-Bridge": "umbridge"}
"""The packages of the recipes, by the last word of a title."""
PORT = "4242"
PATIENCE = 60.0
"""Longest time to the start of a server [s]."""


def write_files(text: str, folder: Path) -> None:
    for fence in FENCE.finditer(text):
        if fence["file"]:
            (folder / fence["file"]).write_text(fence["body"], encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the trained model of the page."""
    made = make_folder(tmp_path_factory.mktemp("recipes"))
    write_files(PREPARED, made)
    run([sys.executable, "cavity.py"], made)
    return made


def wait_for(port: int, server: subprocess.Popen[bytes]) -> None:
    ends = time.monotonic() + PATIENCE
    while server.poll() is None and time.monotonic() < ends:
        with suppress(OSError), socket.create_connection(("localhost", port)):
            return
        time.sleep(0.1)
    raise AssertionError("the server does not answer")


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.split("\n")[0])
def test_recipes(part: str, folder: Path) -> None:
    pytest.importorskip(PACKAGES[part.split("\n")[0].split()[-1]])
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    text = part.replace(PORT, str(port))
    write_files(text, folder)
    fences = [(fence["kind"], fence["body"]) for fence in FENCE.finditer(text) if not fence["file"]]
    (program,) = (body for kind, body in fences if kind == "python")
    (shown,) = (body for kind, body in fences if kind == "text")
    server = None
    if "`server.py`:" in text:
        server = subprocess.Popen([sys.executable, "server.py"], cwd=folder)
    try:
        if server is not None:
            wait_for(port, server)
        check_output(shown.splitlines(), run([sys.executable, "-c", program], folder))
    finally:
        if server is not None:
            server.kill()
            server.wait(PATIENCE)
