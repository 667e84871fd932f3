"""Functions for users, from Python and from the command line.

They are run, plan, budget, online, evaluate, why, bound, filter_measurements and next_time. Each
function takes a job or a run, returns an object with results, and prints nothing. A `Planner` keeps
what was measured, and is told more.
"""
