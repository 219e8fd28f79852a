"""docs/run-file.md is true."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

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
