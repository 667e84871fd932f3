"""The job file: TOML in, frozen and validated data out. Nothing is built or computed here."""
