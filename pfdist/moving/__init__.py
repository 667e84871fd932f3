"""Particles that move: at each measurement, whole lines of particles take Metropolis steps."""
