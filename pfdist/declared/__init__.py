"""How things that a job can name are declared where they are defined, and how text is read.

Nothing here knows what is declared: sections are frozen, validated data, and a registry is a table
that the declaring modules fill.
"""
