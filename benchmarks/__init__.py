"""Measurements of the time that pfdist takes: ``python -m benchmarks [NAME ...] [--quick]``.

Each benchmark measures tables, describes them in Markdown and draws a figure; see `results`. Tests
assert no times, because a time holds only for the machine that is named beside it.
"""
