"""What every floor may use: sections of a job file, registries, keys of noise, reading of text.

Nothing here knows a model, a search or a run.
"""
