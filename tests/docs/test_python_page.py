"""The example of the page about Python runs as the page shows it."""

import re
from pathlib import Path

import pandas as pd
import pytest

import pfdist

PAGE = (Path(__file__).parents[2] / "docs" / "python.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.usefixtures("ray_cluster")
def test_the_example_runs_and_its_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = re.search(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert found is not None
    script, scope = tmp_path / "script.py", {"__name__": "__main__"}
    script.write_text(found[1], encoding="utf-8")  # the source of the model's formulas
    exec(compile(found[1], script, "exec"), scope)
    run = scope["run"]
    assert isinstance(run, pfdist.Run)
    assert run.path == Path("results/robot")
    for times in run.sets().values():
        assert len(times) == 5
        assert not set(times) & set(range(8, 12))
    gains = run.gains()
    assert isinstance(gains, pd.DataFrame)
    assert len(gains) == 2000
    changes = ["comparison.draws=2000"]
    found_worth = pfdist.why(scope["problem"], 500, changes=changes, figures=False).worth
    pd.testing.assert_frame_equal(found_worth, run.worth())
