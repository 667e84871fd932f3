"""Parameters of a model that real measurements fit."""

from pfdist.common.plugins import Plugin

PLUGIN = Plugin(
    names=("pfdist.plugins.fit.question:fit",),
    plots=("pfdist.plugins.fit.figure:likelihood_profile",),
)
