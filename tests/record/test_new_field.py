"""A result field is declared once: a line in results/job.py brings it into run file, page, export and JSON."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = """
import json, sys, types
from dataclasses import replace
from pathlib import Path

import edmctl.results

source = Path("edmctl/results/job.py").read_text(encoding="utf-8")
last = '''    drift_by_rests: bool = flag("1 when the rests tell it, by a drift file")
'''
assert last in source
line = '    roundness_um: float = um("roundness of the wall", default=math.nan)' + chr(10)
module = sys.modules["edmctl.results.job"] = types.ModuleType("edmctl.results.job")
exec(compile(source.replace(last, last + line), "job.py", "exec"), module.__dict__)

from edmctl.jsonout import to_json_value
from edmctl.record.reader import open_run
from edmctl.record.reader import sites_of
from edmctl.record.writer import RunWriter
from edmctl.report.export import ExportTable
from tests.record.samples import a_meta, a_site_row
from tools.generate.run_file_page import layout_tables

row = replace(a_site_row(), roundness_um=0.25)
writer = RunWriter.create(Path(sys.argv[1]), a_meta())
writer.append(row)
with open_run(writer.finish("done", 0)) as run:
    table = ExportTable(run, "results", {})
    (block,) = table.blocks()
    exported = {column.name: values[0] for column, values in zip(table.columns, block)}
    (site,) = sites_of(run)
print(json.dumps({
    "result": to_json_value(row)["roundness_um"],
    "read": site.roundness_um,
    "shown": site.as_mapping()["roundness_um"],
    "exported": float(exported["roundness_um"]),
    "page": "| `roundness` | f8 | um | roundness of the wall |" in layout_tables(),
}))
"""


def test_a_new_field_needs_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "run.h5")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=120)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found.pop("page")
    assert set(found.values()) == {0.25}, found
