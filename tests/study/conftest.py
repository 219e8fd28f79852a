"""A study whose runs are done, made once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.study.running import run_virtual
from tests.study.studies import Unseen, made

if TYPE_CHECKING:
    from edmctl.study.folder import StudyFolder


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A small study that nothing has interrupted; tests that change it copy its folder."""
    study = made(tmp_path_factory.mktemp("whole"))
    run_virtual(study, Unseen())
    return study
