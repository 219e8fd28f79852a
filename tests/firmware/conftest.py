"""The firmware's core, built once; where there is no C compiler its tests are skipped."""

from __future__ import annotations

import pytest

from edmctl.errors import PreconditionError
from edmctl.firmware.build import Build, built


@pytest.fixture(scope="session")
def core() -> Build:
    """The library in double arithmetic."""
    try:
        return built()
    except PreconditionError as error:
        if error.code == "E8093":
            pytest.skip(error.message)
        raise
