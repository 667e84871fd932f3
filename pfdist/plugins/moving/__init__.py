"""Particles that move: at each measurement, whole lines of particles take Metropolis steps."""

from pfdist.common.plugins import Plugin

PLUGIN = Plugin(proposals=("pfdist.plugins.moving.proposal:MOVING",))
