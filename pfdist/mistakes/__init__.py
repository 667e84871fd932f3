"""Explanations of errors in a model's code: where they come from, and what to write instead."""
