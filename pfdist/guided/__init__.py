"""Guided particles: noise since the last measurement is redrawn when the next one is known."""
