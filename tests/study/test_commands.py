"""`edmctl study` as people and scripts use it."""

from __future__ import annotations

import csv
import io
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from edmctl.profile.folders import shipped_studies
from edmctl.study.commands import _suggestion
from edmctl.study.folder import StudyFolder, open_folder
from edmctl.study.results import RunKind
from edmctl.study.suggestions import suggested_runs
from tests.cli.commands import Here
from tests.study.studies import written


@pytest.fixture
def folder(whole: StudyFolder, tmp_path: Path) -> Path:
    """A study that was run."""
    written(tmp_path)
    copy = tmp_path / "out"
    shutil.copytree(whole.path, copy)
    return copy


def test_a_plan_is_shown_and_nothing_is_written(tmp_path: Path, here: Here) -> None:
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
    listed = here("study", "list", "--json").document["result"]["studies"]
    assert {one["study"] for one in listed} == set(shipped_studies())


def test_responses_judgements_table_and_report(tmp_path: Path, folder: Path, here: Here) -> None:
    out = str(folder)
    assert "ra_um of runs 1, 2, 3, 4" in here("study", "status", out).out
    table = tmp_path / "ra.csv"
    table.write_text("run,ra_um\n1,0.31\n2,0.29\n3,0.33\n4,0.30\n", encoding="utf-8")
    assert here("study", "import", out, str(table)).exit_code == 0
    assert here("study", "tell", out, "2", "ra_um=0.28").exit_code == 0
    assert here("study", "judge", out, "3", "reject", "a chip under the tool").exit_code == 0
    status = here("study", "status", out, "--json").document["result"]
    assert status["counts"] == {"open": 0, "done": 3, "failed": 0, "rejected": 1}
    text = here("study", "export", out).out
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["run"] for row in rows] == ["1", "2", "3", "4"]
    assert {"servo.reference", "pulse.duty", "machining_time_s", "ra_um", "truth.depth_um"} <= set(rows[0])
    assert (rows[1]["ra_um"], rows[2]["reason"]) == ("0.28", "a chip under the tool")
    assert here("study", "export", out, "-o", str(tmp_path / "table.csv")).exit_code == 0
    assert (tmp_path / "table.csv").read_text(encoding="utf-8") == text
    assert here("study", "judge", out, "3", "accept", "it was none").exit_code == 0
    report = here("study", "report", out, "--json")
    assert report.exit_code == 0, report.err
    found = {one["name"]: one for one in report.document["result"]["responses"]}
    assert {row["name"] for row in found["machining_time_s"]["anova"]["rows"]} >= {"reference", "duty"}
    assert found["machining_time_s"]["anova"]["error"]["dof"] == 0
    assert found["machining_time_s"]["pooled_anova"]["pooled"]


@pytest.mark.slow
def test_a_page_is_written_once(tmp_path: Path, folder: Path, here: Here) -> None:
    page = tmp_path / "page.html"
    assert here("study", "report", str(folder), "--out", str(page)).exit_code == 0
    assert "<script" not in page.read_text(encoding="utf-8")
    assert here("study", "report", str(folder), "--out", str(page)).exit_code == 9


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
        (("export", "OUT", "--json"), 2, "E2083"),
    ],
)
def test_a_mistake_has_its_code(
    tmp_path: Path, folder: Path, here: Here, arguments: tuple[str, ...], exit_code: int, code: str
) -> None:
    names = {"OUT": str(folder), "STUDY": str(tmp_path / "study.toml")}
    said = here("study", *(names.get(one, one) for one in arguments))
    assert said.exit_code == exit_code
    assert f"error[{code}]" in said.err or said.document["error"]["code"] == code
