"""Property tests here are repeatable and not judged by the clock."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("link", deadline=None, derandomize=True, database=None)
settings.load_profile("link")
