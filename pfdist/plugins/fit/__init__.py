"""Parameters of a model that real measurements fit."""

from pfdist.common.plugins import Name, Plugin

PLUGIN = Plugin(
    names={
        "pfdist.plugins.fit.question:fit": Name(
            "data", 'pfdist.fit("days.toml", "days.csv", ["clearance"]).parameters'
        ),
    },
    plots=("pfdist.plugins.fit.figure:likelihood_profile",),
)
