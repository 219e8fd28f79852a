"""What every table of a profile or setup file is."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

ONE_LINE = r"^[^\x00-\x1f\x7f]*$"
"""No control characters: HDF5 texts end at a NUL, and a terminal obeys the others."""


class Table(BaseModel):
    """A table of a profile or setup file: closed, immutable, no silent conversions."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
