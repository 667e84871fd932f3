"""The page on sweeps: its example draws the loss of wrong beliefs."""

import re
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

import pfdist

ROOT = Path(__file__).parents[2]
SMALL = (
    "problem.horizon=12", "problem.measurement_budget=4", "filter.particles=30",
    "comparison.draws=60", 'search=[{method="random", evaluations=3}]', "evaluation.draws=20",
)  # fmt: skip


@pytest.mark.slow
def test_the_example_draws_the_loss_of_wrong_beliefs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times found for the true model lose nothing."""
    text = (ROOT / "docs" / "sweep.md").read_text(encoding="utf-8")
    [example] = [code for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL)
                 if "heat_map" in code]  # fmt: skip
    whole = pfdist.sweep

    def small(file: str) -> pfdist.Sweep:
        assert (ROOT / file).is_file()
        keys = ("model.parameters.process_sd", "model.filter.parameters.process_sd")
        return whole(
            ROOT / "jobs" / "plan.toml", {key: [0.5, 2.0] for key in keys}, judge=True,
            pool="serial", results=tmp_path / "sweep", changes=SMALL, report=False,
        )  # fmt: skip

    monkeypatch.setattr(pfdist, "sweep", small)
    names: dict[str, Any] = {"pfdist": pfdist}
    exec(example, names)
    wrong = names["wrong"]
    assert len(wrong) == 4
    is_right = wrong[names["truth"]] == wrong[names["believed"]]
    assert (wrong.loc[is_right, "loss"] == 0).all()
    [axes, _] = plt.gcf().axes
    assert axes.get_xlabel() == "model.parameters.process_sd"
    plt.close("all")
