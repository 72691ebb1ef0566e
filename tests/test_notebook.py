"""The notebook runs from top to bottom, in a folder of its own."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

pytest.importorskip("ipykernel", reason="ipykernel is not installed")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")

ROOT = Path(__file__).parents[1]
NOTEBOOK = ROOT / "cases" / "notebook.ipynb"
STREAMS = ("stdout", "stderr")
CELL_SECONDS = 900
"""What a cell may take on a busy machine, kernels that have to be compiled included."""


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(ROOT / "cases" / "taylor_green_demo.yaml", tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path / "runtime"))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = nbclient.NotebookClient(
        notebook,
        timeout=CELL_SECONDS,
        startup_timeout=CELL_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    )
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    texts = {name: [o["text"] for o in outputs if o.get("name") == name] for name in STREAMS}
    assert texts["stderr"] == []
    assert "\nrelative L2 error of the velocity at the end:" in "".join(texts["stdout"])
    assert sum("image/png" in output.get("data", ()) for output in outputs) == 3
    assert (tmp_path / "runs" / "notebook" / "operators.h5").exists()


def test_the_notebook_is_kept_without_outputs() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
