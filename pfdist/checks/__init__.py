"""Checks of models, formulas and machines.

A check computes little, changes nothing, and answers in sentences.
"""
