"""Lower bounds in a run's tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd


_OF_THE_SET = ["position", "name", "measurement_times"]


def last_bounds(rows: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """The proof of most compared draws, then most particle-steps, by the set's name.

    Parameters
    ----------
    rows : DataFrame
        As of `pfdist.analysis.Run.bounds`.
    """
    last = rows.sort_values(["compared_draws", "steps"], kind="stable").groupby("name").tail(1)
    proofs = last.drop(columns=_OF_THE_SET).to_dict("records")
    for proof in proofs:
        for key in proof.keys() & {"path", "shares"}:
            proof[key] = proof[key].tolist()
    return dict(zip(last["name"], proofs, strict=True))
