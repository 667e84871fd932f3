"""The sections of a report about a run. Each module gives one, or None if the run has none."""
