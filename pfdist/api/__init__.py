"""What a user calls, from Python and from the command line: run, plan, budget, evaluate, why.

Each function takes a job, gives an object with results, and prints nothing.
"""
