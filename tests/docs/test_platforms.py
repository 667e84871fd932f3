"""The page about installing: what it names exists; workflows install what is locked."""

from pathlib import Path

import yaml


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


def test_workflows_install_locked_versions_on_every_python() -> None:
    """With --no-deps, the checkout alone is installed."""
    root = Path(__file__).parents[2]
    text = (root / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    steps = [step for job in yaml.safe_load(text)["jobs"].values() for step in job["steps"]]
    installs = [step["run"] for step in steps if "pip install" in step.get("run", "")]
    assert installs
    for line in installs:
        assert {"--require-hashes", "--no-deps"} & set(line.split()), line
