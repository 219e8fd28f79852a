"""Settings of all tests."""

from __future__ import annotations

from hypothesis import settings

# A busy machine is no failure, the same tree gives the same examples, and nothing is left in the tree.
settings.register_profile("edmctl", deadline=None, derandomize=True, database=None)
settings.load_profile("edmctl")
