"""Parts for every floor: sections of a job file, registries, keys of noise, reading of text.

Nothing here depends on a model, a search or a run.
"""
