"""Everything that is made from data files and models is up to date."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.generate import __main__ as generate
from tools.generate.text import filled


@pytest.mark.needs("ruff")
def test_generated_files_are_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert generate.main(["--check"]) == 0
    assert capsys.readouterr().out == ""


def test_a_stale_file_is_named_and_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stale = tmp_path / "messages.py"
    stale.write_text("old")
    monkeypatch.setattr(generate, "_sources", dict)
    monkeypatch.setattr(generate, "_pages", lambda: {stale: "new"})
    assert generate.main(["--check"]) == 1
    assert stale.read_text() == "old"
    assert "messages.py is out of date" in capsys.readouterr().out
    assert generate.main([]) == 0
    assert stale.read_text() == "new"


def test_a_marker_of_no_part_is_refused() -> None:
    page = "<!-- begin a -->\nold\n<!-- end a -->\n"
    assert filled(page, {"a": "new\n"}) == "<!-- begin a -->\nnew\n<!-- end a -->\n"
    with pytest.raises(KeyError):
        filled(page, {})
