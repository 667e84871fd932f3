"""The tables of a run as a tree of labelled arrays, for xarray and ArviZ."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pfdist.analysis.stored_run import StoredRun, gains_of, problem_of
from pfdist.errors import PfdistError
from pfdist.store.schema import components_in

if TYPE_CHECKING:
    import xarray


def datatree_of(run: StoredRun) -> xarray.DataTree:
    """The tree that `pfdist.Run.to_datatree` describes."""
    try:
        import xarray  # noqa: PLC0415  an optional library
    except ModuleNotFoundError:
        raise PfdistError(
            "to_datatree needs xarray, which is not installed: pip install 'pfdist[notebook]'"
        ) from None
    groups = {"comparison": _comparison, "trajectories": _trajectories, "evaluations": _evaluations}
    tables = run.tables
    tree: dict[str, xarray.Dataset] = {
        name: group(run) for name, group in groups.items() if name in tables
    }
    about = {"run": str(run.path), "state": run.state, "model": run.job["model"]["name"]}
    problem = problem_of(run)
    if problem.has_clock:
        about["time_unit"] = problem.clock.unit
    return xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=about), **tree})


def _comparison(run: StoredRun) -> xarray.Dataset:
    import xarray  # noqa: PLC0415  an optional library

    errors, gains = run.table("comparison").set_index("draw"), gains_of(run).set_index("draw")
    # A reference has no gain over itself.
    gains = gains.reindex(columns=[f"gain_{name}" for name in run.names])
    mse = errors[[f"mse_{name}" for name in run.names]]
    group = xarray.Dataset(
        {"mse": (("draw", "set"), mse.to_numpy()), "gain": (("draw", "set"), gains.to_numpy())},
        {"draw": errors.index, "set": run.names},
    )
    return group.assign(scenario=("draw", errors["scenario"])) if "scenario" in errors else group


def _trajectories(run: StoredRun) -> xarray.Dataset:
    import xarray  # noqa: PLC0415  an optional library

    rows = run.table("trajectories")
    quantities = [each.suffix for each in components_in(rows, "z_")]
    measured = [each.suffix for each in components_in(rows, "y_")]
    cube = rows.set_index(["draw", "t"]).to_xarray().rename(t="time")

    def stacked(columns: list[str], *shape: int) -> Any:
        """Columns as the last axes of an array, (draw, time, ...)."""
        values = np.stack([cube[column].to_numpy() for column in columns], axis=-1)
        return values.reshape(*values.shape[:2], *shape)

    estimates = [f"estimate_{name}_{suffix}" for name in run.names for suffix in quantities]
    arrays = {
        "z": (("draw", "time", "component"), stacked([f"z_{each}" for each in quantities], -1)),
        "y": (("draw", "time", "measured"), stacked([f"y_{each}" for each in measured], -1)),
        "estimate": (
            ("draw", "time", "set", "component"),
            stacked(estimates, len(run.names), len(quantities)),
        ),
    }
    names = {"set": run.names, "component": quantities, "measured": measured}
    return xarray.Dataset(arrays, {"draw": cube["draw"], "time": cube["time"], **names})


def _evaluations(run: StoredRun) -> xarray.Dataset:
    rows = run.table("evaluations")
    # Sets have several lengths, and an array of texts can be saved.
    texts = [", ".join(map(str, times)) for times in rows["measurement_times"]]
    return rows.assign(measurement_times=texts).rename_axis("row").to_xarray()
