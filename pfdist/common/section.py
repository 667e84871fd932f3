"""A section of a job file: frozen, validated data."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """Base of every section of a job file: frozen, strict about types, without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
