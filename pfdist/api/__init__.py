"""Functions for users, from Python and from the command line: run, plan, budget, evaluate, why.

Each function takes a job or a run, returns an object with results, and prints nothing.
"""
