"""Questions of users, asked from Python and from the command line; a module a question.

They are run, plan, budget, compare, online, rule, sweep, bound, why, evaluate, filter_measurements,
next_time, check_model, simulate, list_runs, table and report. Each function takes a job or a run,
returns an object with results, and prints nothing. A module ``X_page`` words the answer of the
question X. A `Planner` keeps the measurements of a system and takes further ones.
"""
