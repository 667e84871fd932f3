"""The page about installing: what it names exists."""

from pathlib import Path


def test_every_file_and_extra_that_the_page_names_exists() -> None:
    root = Path(__file__).parents[2]
    page = (root / "docs" / "install.md").read_text(encoding="utf-8")
    files = {
        "requirements/locked.txt",
        "docker/Dockerfile",
        "jobs/quick.toml",
        "docs/notebook.ipynb",
    }
    assert all((root / file).is_file() for file in files)
    assert all(Path(file).name in page for file in files)
    extras = (root / "pyproject.toml").read_text(encoding="utf-8")
    for name in ("test", "notebook", "cluster", "docs"):
        assert f"'.[{name}]'" in page
        assert f"\n{name} = [" in extras
