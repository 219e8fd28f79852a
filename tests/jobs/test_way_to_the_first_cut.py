"""The way from the command line to the first cut: project functions that a reader follows, by the call stack."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import edmctl
from edmctl.errors import PreconditionError
from edmctl.link.messages import ServoStart
from edmctl.link.session import Session
from tests.cli.commands import SHALLOW, Here

if TYPE_CHECKING:
    import pytest

ROOT = Path(edmctl.__file__).parent
MOST_FUNCTIONS, MOST_FOLDERS = 25, 8


def functions_on_stack() -> list[str]:
    """Distinct project functions as `folder/file.py function`, the outermost first."""
    frame, found = sys._getframe(2), list[str]()
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if path.is_relative_to(ROOT):
            found.append(f"{path.relative_to(ROOT).as_posix()} {frame.f_code.co_qualname}")
        frame = frame.f_back  # type: ignore[assignment]
    return list(dict.fromkeys(reversed(found)))


def test_the_way_to_the_first_cut_is_short(
    here: Here, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stack: list[str] = []
    request = Session.request

    def watched(self: Session, message: Any) -> Any:
        if isinstance(message, ServoStart):
            stack.extend([*functions_on_stack(), "link/session.py Session.request"])
            raise PreconditionError("The first cut was seen.")
        return request(self, message)

    monkeypatch.setattr(Session, "request", watched)
    said = here("machine", *SHALLOW, "--quiet", "--seed", "1", "--out", str(tmp_path))
    print("\n".join(stack))
    folders = {name.partition(" ")[0].rpartition("/")[0] for name in stack}
    assert 15 <= len(stack) <= MOST_FUNCTIONS, stack
    assert len(folders) <= MOST_FOLDERS, folders
    assert "jobs/job.py carry_out" in stack
    assert "The first cut was seen." in said.err
