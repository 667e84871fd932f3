"""Sweep files that ship."""

from pathlib import Path

import pytest

from pfdist.plugins.sweep.question import foreseen

JOBS = Path(__file__).parents[3] / "jobs"
SWEEPS = sorted(path for path in JOBS.glob("*.toml") if "\njob = " in path.read_text())


@pytest.mark.zoo
@pytest.mark.parametrize("path", SWEEPS, ids=lambda path: path.stem)
def test_every_point_of_a_sweep_file_can_be_built(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The speed of the model is measured in tests of sweeps."""
    monkeypatch.setattr("pfdist.questions.foreseen.seconds_a_step", lambda *_, **__: 1e-9)
    points = foreseen(path)
    assert len(points) > 1
    assert (points["steps"] > 0).all()
