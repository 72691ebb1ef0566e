"""What is published with the program: its cases, its versions, and how to cite it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml

import sphrom
from sphrom.case import template
from sphrom.case.loader import load_case

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())


def test_package_carries_the_cases_and_the_constraints() -> None:
    package = Path(sphrom.__file__).parent
    for name in ("cases", "constraints.txt"):
        assert (package / name).samefile(ROOT / name)
    patterns = PROJECT["tool"]["setuptools"]["package-data"]["sphrom"]
    carried = {path for pattern in patterns for path in package.glob(pattern) if path.is_file()}
    wanted = {path for path in (package / "cases").glob("**/*.*") if path.suffix != ".h5"}
    wanted = {path for path in wanted if "runs" not in path.parts}
    assert wanted | {package / "constraints.txt", package / "py.typed"} <= carried
    assert {path.suffix for path in carried} <= {".yaml", ".md", ".txt", ".typed", ".ipynb",
                                                ".mk", ".smk"}  # fmt: skip


def test_folder_of_a_clone_does_not_hide_the_package(tmp_path) -> None:
    """A folder `sphrom` beside a program could be imported as a namespace package."""
    (tmp_path / "sphrom").mkdir()
    (tmp_path / "program.py").write_text("import sphrom; print(sphrom.__version__)")
    for words in (["-m", "sphrom", "--version"], ["program.py"]):
        done = subprocess.run(
            [sys.executable, *words], cwd=tmp_path, capture_output=True, text=True, timeout=300
        )
        assert done.stdout.split()[-1:] == [sphrom.__version__], done.stderr


def test_version_is_told_once() -> None:
    assert PROJECT["project"]["dynamic"] == ["version"]
    assert CITATION["version"] == sphrom.__version__


def test_authors_and_addresses_agree_and_the_paper_has_a_journal_s_length() -> None:
    project = PROJECT["project"]
    names = [author["name"] for author in project["authors"]]
    _, head, body = (ROOT / "paper" / "paper.md").read_text().split("---\n", 2)
    for authors in (CITATION["authors"], yaml.safe_load(head)["authors"]):
        assert [author["name"] for author in authors] == names
    assert CITATION["repository-code"] == project["urls"]["Repository"]
    for page in ("README.md", "CONTRIBUTING.md"):
        assert project["urls"]["Issues"] in (ROOT / page).read_text()
    assert 750 <= len(body.split()) <= 1750
    cited = set(re.findall(r"@(\w+)\]", body))
    assert cited == set(re.findall(r"@\w+\{(\w+),", (ROOT / "paper" / "paper.bib").read_text()))


def test_cases_are_listed_with_what_they_are(sphrom) -> None:
    listed = sphrom("case", "examples").stdout.splitlines()
    assert {line.split()[0] for line in listed} == set(template.examples())
    assert all(len(line.split()) > 3 for line in listed)


def test_case_that_comes_with_the_program_is_written_once(sphrom, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = sphrom("case", "examples", "cylinder", code=0)
    assert result.stdout == "wrote cylinder.yaml; next: sphrom run cylinder.yaml\n"
    assert load_case("cylinder.yaml").name == "cylinder"
    again = sphrom("case", "examples", "cylinder", code=2)
    assert "cylinder.yaml: exists already; --force overwrites it" in again.stderr
    wrong = sphrom("case", "examples", "cilinder", code=2)
    assert "is called 'cilinder'; did you mean cylinder?" in wrong.stderr


def test_make_takes_a_python_that_is_new_enough_or_says_which_one_it_needs(tmp_path) -> None:
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        (tmp_path / name).symlink_to(ROOT / name)
    programs = tmp_path / "programs"
    programs.mkdir()

    def make() -> subprocess.CompletedProcess[str]:
        """Say what `make setup` would do with these programs alone."""
        return subprocess.run(
            [shutil.which("make"), "-n", "setup"], cwd=tmp_path, env={"PATH": str(programs)},
            capture_output=True, text=True, timeout=60,
        )  # fmt: skip

    for name, status in (("python3", 1), ("python3.12", 0)):
        (programs / name).write_text(f"#!/bin/sh\nexit {status}\n")
        (programs / name).chmod(0o755)
    assert "python3.12 -m venv .venv" in make().stdout
    (programs / "python3.12").unlink()
    check = make().stdout.partition("-m venv")[0].rpartition("\n")[0]
    (programs / "sh").symlink_to("/bin/sh")
    refused = subprocess.run(["/bin/sh", "-c", check], capture_output=True, text=True, timeout=60)
    assert refused.returncode == 1
    assert "sphrom needs Python 3.11 or later" in refused.stderr
