"""A study whose runs are done, made once."""

from __future__ import annotations

import pytest

from edmctl.study.folder import StudyFolder, open_folder
from edmctl.study.running import run_virtual
from tests.golden import once
from tests.study.studies import Unseen, made


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A small study that nothing has interrupted; tests that change it copy its folder."""
    folder = once(tmp_path_factory, "study", lambda folder: run_virtual(made(folder), Unseen()))
    return open_folder(folder / "made")
