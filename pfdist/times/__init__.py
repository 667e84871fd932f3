"""Sets of measurement times: the constraints on a set, and the sets that are feasible.

This room computes with integers and tuples of times; it knows no model and no job file.
"""
