"""The one writer of CSV: spreadsheets compute nothing, numbers stay numbers, texts are read back unchanged."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest

import edmctl
from edmctl.csv_text import plain_text, table_text
from edmctl.profile.places import read_places_file
from edmctl.record.delimited import Table
from edmctl.report.export import CsvWriter, ExportColumn

TEXTS = [
    "=1+1",
    "+A1",
    "-A1",
    "@SUM(A1)",
    "'=1",
    "''-x",
    "'quoted'",
    "a,b",
    'say "hi"',
    "=a,b",
    "-1.5",
    "+2e-3",
    "-",
    "site-1",
    "µm",
]
FORMULA = re.compile(r"[=@]|[-+](?![0-9.]+(e[-+]?[0-9]+)?$)")


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_read_back_and_never_computed(text: str) -> None:
    import pandas as pd

    table = table_text([{"name": text, "depth_um": -1.5, "count": 3, "unknown": None, "nan": float("nan")}])
    ((_, row),) = Table(table, "table.csv", ["name", "depth_um", "count", "unknown", "nan"]).rows()
    assert row == {"name": text, "depth_um": "-1.5", "count": "3", "unknown": "", "nan": ""}
    cell = pd.read_csv(io.StringIO(table), dtype={"name": str})["name"][0]
    assert not FORMULA.match(cell)
    assert plain_text(cell) == text


def test_numbers_stay_numbers_in_every_program() -> None:
    import pandas as pd

    frame = pd.read_csv(
        io.StringIO(table_text([{"x_um": -1.5, "swept": "-2e-3"}, {"x_um": 2, "swept": "1"}]))
    )
    assert frame["x_um"].tolist() == [-1.5, 2.0]
    assert frame["swept"].tolist() == [-2e-3, 1.0]


def test_an_exported_site_is_no_formula_and_may_be_a_place_again(tmp_path: Path) -> None:
    sink = io.BytesIO()
    columns = [
        ExportColumn(name, np.dtype(kind), "", "")
        for name, kind in (("name", "O"), ("x_um", "f8"), ("y_um", "f4"))
    ]
    CsvWriter(sink, columns).write([np.array(["=1+1"], object), np.array([-1.5]), np.array([-2.5], "f4")])
    assert sink.getvalue() == b"name,x_um,y_um\n'=1+1,-1.5,-2.5\n"
    file = tmp_path / "places.csv"
    file.write_bytes(sink.getvalue())
    ((place, _),) = read_places_file(file)
    assert (place.name, place.x_um, place.y_um) == ("=1+1", -1.5, -2.5)


def test_nothing_else_writes_csv() -> None:
    other = re.compile(r"csv\.writer|DictWriter|to_csv|savetxt\(|[\"'],[\"']\.join")
    folder = Path(edmctl.__file__).parent
    found = [path.name for path in folder.rglob("*.py") if other.search(path.read_text(encoding="utf-8"))]
    assert found == ["csv_text.py"]
