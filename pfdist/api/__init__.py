"""Functions for users, from Python and from the command line.

They are run, plan, budget, evaluate, why, bound and filter_measurements. Each function takes a job
or a run, returns an object with results, and prints nothing.
"""
