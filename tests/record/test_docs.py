"""docs/run-file.md is true."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import h5py

from edmctl.cli.exitcodes import MEANING
from edmctl.record.documentation import replace_between_markers

if TYPE_CHECKING:
    import pytest

PAGE = Path(__file__).parents[2] / "docs" / "run-file.md"


def test_the_tables_are_those_of_the_layout() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert replace_between_markers(page) == page


def test_the_h5py_example_runs(
    run_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    example = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    monkeypatch.chdir(run_path.parent)
    exec(compile(example, "run-file.md", "exec"), {})
    assert capsys.readouterr().out.splitlines() == [
        "done 100.0 s, mean gap voltage 4999.9 V",
        "A1 depth 180.0 ± 0.9 µm",
    ]


def test_each_status_stands_there_with_its_exit_code() -> None:
    rows = re.findall(r"^  \| `([^`]+)` \| (\d+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    meaning = {str(int(code)): text.partition(" (")[0] for code, text in MEANING.items()}
    never_in_a_finished_file = {"2", "3", "9"}
    assert {code: status for status, code in rows} == {
        code: text for code, text in meaning.items() if code not in never_in_a_finished_file
    }


def test_the_line_that_decodes_the_summary_runs(run_path: Path) -> None:
    (line,) = re.findall(r"`(json\.loads\([^`]*)`", PAGE.read_text(encoding="utf-8"))
    with h5py.File(run_path) as run:
        assert eval(line, {"json": json, "run": run}) == {"ok": True}
