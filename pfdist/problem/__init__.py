"""The job: TOML or objects in, frozen and validated data out; constraints and feasible sets.

The clock and its dates are here, and the tables of users with times. Rooms below count instants.

This room builds no objects.
"""
