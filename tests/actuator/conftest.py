"""Property tests here are repeatable and not judged by the clock."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("actuator", deadline=None, derandomize=True, database=None)
settings.load_profile("actuator")
