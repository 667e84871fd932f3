"""Functions for users, from Python and from the command line.

They are run, plan, budget, online, evaluate, why and bound. Each function takes a job or a run,
returns an object with results, and prints nothing.
"""
