"""Sets of measurement times: the constraints on them, and which sets are feasible.

Integer arithmetic on tuples of times; nothing here knows a model.
"""
