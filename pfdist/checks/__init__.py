"""Checks of models, formulas and machines.

A check takes little time, changes nothing, and answers in sentences.
"""
