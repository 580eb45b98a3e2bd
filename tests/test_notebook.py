"""The researcher's notebook runs from top to bottom and gives what it says."""

from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[1] / "examples" / "estimator.ipynb"


@pytest.mark.filterwarnings("ignore")  # of the notebook's machinery
def test_the_notebook_runs_and_shows_its_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.read(NOTEBOOK, 4)
    nbclient.NotebookClient(
        notebook, timeout=500, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    kinds = {kind for output in outputs for kind in output.get("data", {})}
    assert {"text/html", "image/png"} <= kinds
    (faults, *_) = [o["data"]["text/html"] for o in outputs if "text/html" in o.get("data", {})]
    assert "HIL_SENSOR.xgyro" in faults
    assert not [output for output in outputs if output["output_type"] == "error"]
