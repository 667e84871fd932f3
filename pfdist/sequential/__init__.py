"""One system that is measured as time goes by: its filter, and the choice of the next time.

Nothing here reads a job, knows a pool or touches a run's folder.
"""
