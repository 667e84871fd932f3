"""The filter of real measurements of one system."""

from pfdist.common.plugins import Command, Name, Plugin

_FILTER = Command(
    "pfdist.plugins.filter.question:filter_measurements",
    "Filter real measurements of one system, with the filter of a job.",
    {
        "pfdist filter jobs/plan.toml patient.csv": "Filter the measurements of one system",
        "pfdist filter jobs/plan.toml patient.csv --planned evenly_spaced --out new": (
            "Compare them with evenly spaced times, and write to another folder"
        ),
    },
)
PLUGIN = Plugin(
    commands={"Real data": {"filter": _FILTER}},
    words=("pfdist.plugins.filter.words:WORDS",),
    names={
        "pfdist.plugins.filter.question:filter_measurements": Name(
            "data", 'pfdist.filter_measurements(run, "patient.csv").table'
        ),
    },
    plots=(
        "pfdist.plugins.filter.figure:belief",
        "pfdist.plugins.filter.sizes_figure:effective_sample_size",
    ),
)
