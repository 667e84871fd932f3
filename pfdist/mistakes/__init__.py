"""What goes wrong in a model's code: where, why, and what to write instead."""
