"""What is wrong with a model, with a formula, or with this machine.

A check computes little, changes nothing, and answers in sentences.
"""
