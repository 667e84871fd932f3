"""The job file: TOML in, frozen and validated data out. This room builds no objects."""
