"""Fixtures of the command line's tests."""

from __future__ import annotations

import pytest

from tests.cli.commands import Here


@pytest.fixture
def here(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> Here:
    """Run command lines in this process and in an empty folder."""
    for name in (
        "EDMCTL_PROFILE",
        "EDMCTL_PORT",
        "EDMCTL_SETUP",
        "EDMCTL_CALIBRATION",
        "NO_COLOR",
        "FORCE_COLOR",
    ):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("EDMCTL_HOME", str(tmp_path_factory.mktemp("home")))
    monkeypatch.chdir(tmp_path_factory.mktemp("work"))
    return Here(capsys)
