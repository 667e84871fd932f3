"""Lower bounds: no feasible set of measurement times has a lower expected MSE."""
