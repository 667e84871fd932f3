"""What pfdist costs, measured: ``python -m benchmarks [kernel] [peers] [scaling] [--quick]``.

Each of the three measures tables, says them in Markdown and draws one figure; see `results`. They
are never asserted in tests: a figure holds for the machine that stands beside it.
"""
