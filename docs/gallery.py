"""Compute the gallery: ``python docs/gallery.py`` plans each job, and writes figures and a table.

`docs/tables.py` puts the table into the page.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

import pfdist

FOLDER = Path(__file__).parent
JOBS = {  # labels with units: some models leave them to their docstrings
    "plan": ("expected MSE of x", "instant"),
    "tumour": ("expected MSE\nof the position", "time in steps of 0.25 s"),
    "xray_tumour": ("expected MSE [mm²]", "time in steps of 0.25 s"),
    "lorenz63": ("expected MSE\nof (x, y, z)", "time in steps of 0.1"),
    "lotka_volterra": ("expected MSE\nof logarithms", "time"),
    "constant_velocity": ("expected MSE [km²]", "time [min]"),
    "pharmacokinetics": ("expected MSE\nof the logarithm", "time [h]"),
    "drug": ("expected MSE\nof three logarithms", "time [h]"),
    "epidemic": ("expected MSE\nof prevalence [%²]", "time [d]"),
}
DRAWS = 4000


def main() -> None:
    """Plan each job, draw its figure, and write ``gallery.csv``."""
    rows = []
    for name, labels in JOBS.items():
        with tempfile.TemporaryDirectory() as folder:
            run = pfdist.plan(
                FOLDER.parent / "jobs" / f"{name}.toml",
                Path(folder) / name,
                changes=[f"comparison.draws={DRAWS}"],
                bound_draws=0,
                figures=False,
            )
            found = pfdist.table(run).iloc[0]
            _draw(run, FOLDER / "figures" / f"gallery-{name}.png", *labels)
        rows.append(
            {
                "job": name,
                "regular": found["reference_mse"],
                "regular_error": found["reference_standard_error"],
                "found": found["expected_mse"],
                "found_error": found["standard_error"],
                "gain": found["gain_of_means"],
                "gain_low": found["gain_of_means_low"],
                "gain_high": found["gain_of_means_high"],
                "times": " ".join(f"{time:g}" for time in found["measurement_times"]),
            }
        )
        print(rows[-1])  # noqa: T201  it takes minutes
    pd.DataFrame(rows).to_csv(FOLDER / "gallery.csv", index=False, float_format="%.6g")


def _draw(run: pfdist.Run, path: Path, error: str, time: str) -> None:
    with plt.style.context("pfdist.pages.screen"):
        figure, (errors, times) = plt.subplots(
            2, sharex=True, height_ratios=(3, 1), figsize=(6.4, 3.6), layout="constrained"
        )
        profile = run.table("error_over_time")
        pfdist.plots.error_profile(profile, ax=errors).set(xlabel="", ylabel=error)
        pfdist.plots.times(run, ax=times).set_xlabel(time)
        figure.savefig(path, dpi=110)
        plt.close(figure)


if __name__ == "__main__":
    main()
