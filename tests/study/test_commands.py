"""`edmctl study` as people and scripts use it."""

from __future__ import annotations

import csv
import io
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from edmctl.study.commands.execute import _suggestion
from edmctl.study.folder import open_folder
from edmctl.study.results import RunKind
from edmctl.study.suggestions import suggested_runs
from tests.study.studies import written

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.study.folder import StudyFolder
    from tests.cli.commands import Here


@pytest.fixture
def folder(whole: StudyFolder, tmp_path: Path) -> Path:
    """A study that was run."""
    written(tmp_path)
    copy = tmp_path / "out"
    shutil.copytree(whole.path, copy)
    return copy


def test_a_plan_tells_all_and_writes_nothing(tmp_path: Path, here: Here) -> None:
    file = written(tmp_path)
    said = here("study", "plan", str(file))
    assert said.exit_code == 0
    assert "4 runs of 4 points" in said.out
    assert "reference × duty 1, error 0" in " ".join(said.out.split())
    assert "note: one machine (seed) in all" in said.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study.toml"]
    document = here("study", "plan", str(file), "--json").document["result"]
    assert [run["number"] for run in document["runs"]] == [1, 2, 3, 4]
    assert document["costs"]["time_s"] > 0


def test_the_shipped_studies_are_listed(here: Here) -> None:
    said = here("study", "list", "--json")
    assert {one["study"] for one in said.document["result"]["studies"]} >= {
        "taguchi-l9",
        "response-surface",
        "fastest-clean-hole",
    }


@pytest.mark.needs("pyarrow")
def test_a_study_is_run_told_judged_exported_and_reported(tmp_path: Path, folder: Path, here: Here) -> None:
    out = str(folder)
    assert "ra_um of runs 1, 2, 3, 4" in here("study", "status", out).out
    table = tmp_path / "ra.csv"
    table.write_text("run,ra_um\n1,0.31\n2,0.29\n3,0.33\n4,0.30\n", encoding="utf-8")
    assert here("study", "import", out, str(table)).exit_code == 0
    assert here("study", "tell", out, "2", "ra_um=0.28").exit_code == 0
    assert here("study", "judge", out, "3", "reject", "a chip under the tool").exit_code == 0
    status = here("study", "status", out, "--json").document["result"]
    assert status["counts"] == {"open": 0, "done": 3, "failed": 0, "rejected": 1}
    rows = list(csv.DictReader(io.StringIO(here("study", "export", out).out)))
    assert [row["run"] for row in rows] == ["1", "2", "3", "4"]
    assert {"servo.reference", "pulse.duty", "machining_time_s", "ra_um", "truth.depth_um"} <= set(rows[0])
    assert rows[1]["ra_um"] == "0.28"
    assert rows[2]["reason"] == "a chip under the tool"
    for name in ("table.json", "table.parquet", "table.jsonl"):
        said = here("study", "export", out, "-o", str(tmp_path / name))
        assert said.exit_code == 0, said.err
    assert len(json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))) == 4
    assert here("study", "judge", out, "3", "accept", "it was none").exit_code == 0
    page = tmp_path / "page.html"
    report = here("study", "report", out, "--out", str(page), "--json")
    assert report.exit_code == 0, report.err
    found = {one["name"]: one for one in report.document["result"]["responses"]}
    assert {row["name"] for row in found["machining_time_s"]["anova"]["rows"]} >= {"reference", "duty"}
    assert found["machining_time_s"]["anova"]["error"]["dof"] == 0
    assert found["machining_time_s"]["pooled_anova"]["pooled"]
    assert "<script" not in page.read_text(encoding="utf-8")
    taken = here("study", "report", out, "--out", str(page))
    assert taken.exit_code == 9
    profiles = here("study", "export", out, "--profiles", str(tmp_path / "table"))
    assert profiles.exit_code == 0, profiles.err
    for path in profiles.out.split():
        assert here("profile", "check", path).exit_code == 0
    again = here("study", "export", out, "--profiles", str(tmp_path / "table"))
    assert again.exit_code == 9
    assert "Name another folder" in again.err


@pytest.mark.needs("pyarrow")
def test_fields_of_parquet_have_units(tmp_path: Path, folder: Path, here: Here) -> None:
    import pyarrow.parquet as pq

    file = tmp_path / "table.parquet"
    assert here("study", "export", str(folder), "-o", str(file)).exit_code == 0
    schema = pq.read_schema(file)
    found = {
        name: (
            schema.field(name).metadata[b"units"].decode(),
            schema.field(name).metadata[b"long_name"].decode(),
        )
        for name in schema.names
    }
    assert found["machining_time_s"] == ("s", "time with the servo on, s")
    assert found["ra_um"] == ("µm", "ra_um")
    assert found["pulse.duty"] == ("1", "duty")
    assert found["depth_um_u95"] == ("µm", "half of the 95 % interval of depth_um")
    assert found["mrr_mm3_min"][0] == "mm³/min"
    assert found["truth.depth_um"] == ("µm", "true depth, µm")
    assert found["reason"] == ("", "reason")


def test_suggestions_say_what_they_are(folder: Path) -> None:
    state = open_folder(folder).read()
    first = state.runs[0].planned
    again, other = suggested_runs(state, [first.settings, {**first.settings, "pulse.duty": 0.31}])
    assert f"run 5, repeats point {first.point}: servo.reference = " in _suggestion(again, state)
    assert "run 6: servo.reference = " in _suggestion(other, state)
    assert "run 6, a center run: " in _suggestion(replace(other, kind=RunKind.CENTER), state)


@pytest.mark.parametrize(
    ("arguments", "exit_code", "code"),
    [
        (("plan", "nothing.toml"), 2, "E2100"),
        (("status", "."), 2, "E2101"),
        (("resume", "OUT", "--new-tool"), 2, "E2108"),
        (("resume", "OUT", "--port", "sim:bench", "--workers", "2"), 2, "E2108"),
        (("resume", "OUT", "--port", "sim:bench"), 2, "E2103"),
        (("tell", "OUT", "9", "ra_um=1"), 2, "E2104"),
        (("tell", "OUT", "1", "rz_um=1"), 2, "E2105"),
        (("judge", "OUT", "1", "reject", " "), 2, "E2107"),
        (("suggest", "OUT"), 8, "E8210"),
        (("run", "STUDY", "--out", "OUT"), 9, "E9101"),
        (("export", "OUT", "-o", "table.xlsx"), 2, "E2081"),
    ],
)
def test_mistakes_are_told_with_their_remedy(
    tmp_path: Path, folder: Path, here: Here, arguments: tuple[str, ...], exit_code: int, code: str
) -> None:
    names = {"OUT": str(folder), "STUDY": str(tmp_path / "study.toml")}
    said = here("study", *(names.get(one, one) for one in arguments))
    assert said.exit_code == exit_code
    assert f"error[{code}]" in said.err
    assert "help:" in said.err


def test_help_loads_no_library_of_studies() -> None:
    code = (
        "import sys\nfrom edmctl.app import main\n"
        "main(['study', '--help'])\n"
        "print([name for name in ('optuna', 'distributed', 'dask', 'scipy', 'numpy', 'pydantic') "
        "if name in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip().endswith("[]")
