"""The firmware's core, built once; where there is no C compiler its tests are skipped."""

from __future__ import annotations

import pytest

from edmctl.core.build import Build, built
from tests.firmware_tools import built_here


@pytest.fixture(scope="session")
def core() -> Build:
    """The library in double arithmetic."""
    return built_here(built)
