"""The notebook of the manual runs from its first cell to its last, as a reader would run it."""

from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "notebook.ipynb"
SECONDS = 600  # for a cell, on a machine with other work


@pytest.mark.notebook
def test_a_model_is_written_planned_compared_and_plotted_without_a_file(tmp_path: Path) -> None:
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(
        notebook, timeout=SECONDS, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [
        output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", [])
    ]
    assert sum("image/png" in data for data in outputs) == 4
    tables = [data["text/html"] for data in outputs if "text/html" in data]
    assert any("relaxation" in table for table in tables)
    assert any("six_hours" in table and "first_wins" in table for table in tables)
    assert not list(tmp_path.glob("*.py")) + list(tmp_path.glob("*.toml"))
    assert (tmp_path / "results" / "tank" / "tables").is_dir()
