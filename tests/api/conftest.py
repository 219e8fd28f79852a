"""Fixtures of the tests of the Python API."""

from tests.cli.conftest import here as here
