"""Constraints: each is a start, and a step from a measurement to the next, in a file of its own.

A constraint is an automaton over the measurements in the order in which they are made. All else
follows from its step: whether a set is feasible, what may follow, what a rule may still measure,
and what measurements pay for together. A step is plain Python that is also compiled as it is.
"""
