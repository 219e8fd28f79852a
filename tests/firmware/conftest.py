"""The firmware's core, built once."""

from __future__ import annotations

import pytest

from edmctl.core.build import Build, built


@pytest.fixture(scope="session")
def core() -> Build:
    """The library in double arithmetic."""
    return built()
