"""Criteria, a file each, which declares how the criterion is written, computed and said.

An installed package adds one by the entry point ``pfdist.criteria``.
"""
