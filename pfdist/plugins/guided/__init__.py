"""Guided particles: noise since the last measurement is redrawn when the next one is known."""

from pfdist.common.plugins import Plugin

PLUGIN = Plugin(proposals=("pfdist.plugins.guided.proposal:GUIDED",))
