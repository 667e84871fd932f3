"""The job: TOML or objects in, frozen and validated data out; constraints and feasible sets.

This room builds no objects.
"""
