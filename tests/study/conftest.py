"""Fixtures of the tests of studies."""

from tests.cli.conftest import here as here
