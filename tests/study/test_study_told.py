"""Values that people report of runs, one by one and by tables of spreadsheets, and their mistakes."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

import edmctl
from edmctl.errors import ProfileError, UsageError
from edmctl.study.folder import StudyFolder
from edmctl.study.planning import plan_study
from edmctl.study.running import bare_row
from edmctl.study.study_file import read_study
from edmctl.study.table import reported_table, reported_values
from tests.cli.commands import Here
from tests.study.studies import FULL, SMALL, made, written

BOUNDED = SMALL.replace('unit = "µm"', 'unit = "µm"\nlow = 0.0\nhigh = 5.0')


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study that waits for roughnesses; its last run is not made yet."""
    folder = made(tmp_path_factory.mktemp("told"), BOUNDED)
    with folder.writer() as writer:
        for run in folder.plan.runs[:-1]:
            writer.run(bare_row(run, 1, run.seed, datetime.now(UTC)))
    return folder


@pytest.mark.parametrize(
    "content",
    [
        b"run;ra_um\n1;0,31\n2;0,4\n",
        '\ufeffrun;Bemerkung;ra_um\r\n1;"glatt; fein";0,31\r\n2;;0,4\r\n'.encode(),
        b"run,ra_um,,\n1,0.31,,\n2,0.4\n,,,\n",
        b"run,ra_um\n1.0,0.31\n2.0,0.4\n",
        b"# run,ra_um\n1,0.31\n# again\n2,0.4\n",
        b"Lab 3\nsep=,\nRun,Ra_um\n1,0.31\n2,0.4\n",
        b"run;ra_um\n1,0;0,31\n2,0;0,4\n",
        b"\nrun, ra_um\n1, 0.31\n2, 0.4\n3,\n",
        "run;Maß;ra_um\n1;µ;0,31\n2;;0,4\n".encode("latin-1"),
    ],
)
def test_tables_of_spreadsheets_are_read(tmp_path: Path, study: StudyFolder, content: bytes) -> None:
    file = tmp_path / "ra.csv"
    file.write_bytes(content)
    told = reported_table(study.read(), file)
    assert told == {1: {"ra_um": 0.31}, 2: {"ra_um": 0.4}}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "ra.csv is empty"),
        (
            "# lab 3\nrun,Ra_nm\n1,300\n",
            "ra.csv, line 2: no column ra_um in run,Ra_nm. Manual responses are ra_um;",
        ),
        ("x,y\n1,2\n", "ra.csv, line 1: no column run and no ra_um in x,y."),
        ("run,ra_um\n1,0.3\n\n9,0.3\n", "ra.csv, line 4: The study has no run 9"),
        ("run,ra_um\none,0.3\n", "ra.csv, line 2: 'one' is no number of a run"),
        ("run,ra_um\n1.5,0.3\n", "ra.csv, line 2: '1.5' is no number of a run"),
        ("run,ra_um\n1,0_3\n", "ra.csv, line 2: ra_um=0_3: that is no number"),
        ("run,ra_um\n", "ra.csv has no value of ra_um"),
        ("run,ra_um\n1,\n", "ra.csv has no value"),
        ("run,ra_um\n1,n/a\n", "ra_um=none withdraws a reported value"),
        ("run,ra_um\n1,0.3 µm\n", "ra.csv, line 2: ra_um=0.3 µm: that is no number. Give the number alone"),
        ('run,ra_um\n1,"0,3"\n', "ra.csv, line 2: ra_um=0,3: that is no number. Write a decimal point"),
        ("run;ra_um\n1;310\n", "ra.csv, line 2: ra_um = 310 µm is not possible"),
        ("run,ra_um\n1,0.3\n1,0.4\n", "ra.csv, line 3: run 1 is in the table twice"),
        ("run,ra_um\n1,0.3\n4,0.4\n", "ra.csv, line 3: Run 4 is not made yet"),
        (
            "run,ra_um\n2,1,21\n",
            "ra.csv, line 2: 3 cells under a header of 2. Write a decimal point, separate",
        ),
        ("run;ra_um\n2;1;fine\n", "ra.csv, line 2: 3 cells under a header of 2. Delete the cells"),
        ("\nrun,ra_um,ra_um\n2,1,2\n", "ra.csv, line 2: two columns are called ra_um. Keep one"),
    ],
)
def test_what_is_wrong_with_a_table_is_said_with_file_and_line(
    tmp_path: Path, study: StudyFolder, content: str, says: str
) -> None:
    file = tmp_path / "ra.csv"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(UsageError) as refused:
        reported_table(study.read(), file)
    assert says in f"{refused.value.message} {refused.value.hint}"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ra_um", "e.g. ra_um=0.31"),
        ("rz_um=1", "rz_um is not a manual response"),
        ("ra_um=", "has no value"),
        ("ra_um=nan", "Leave out what is not measured"),
        ("ra_um=0,2", "Write a decimal point"),
        ("ra_um=0_2", "Give the number alone"),
        ("ra_um=0.2 µm", "Give the number alone, in µm"),
        ("ra_um=-0.2", "at least 0 and at most 5 µm"),
        ("ra_um=200", "Look at the sign, the decimal point and the unit"),
    ],
)
def test_a_mistyped_value_has_its_own_remedy(study: StudyFolder, text: str, says: str) -> None:
    with pytest.raises(UsageError) as refused:
        reported_values(study.read(), [text])
    assert refused.value.code == "E2105"
    assert says in f"{refused.value.message} {refused.value.hint}"
    name, _, value = text.partition("=")
    if value:
        with pytest.raises(UsageError) as from_python:
            edmctl.Study.load(study.path).tell(1, {name: value})  # type: ignore[dict-item]
        assert from_python.value.code == "E2105"


def test_mistakes_of_a_command_end_with_2(tmp_path: Path, study: StudyFolder, here: Here) -> None:
    file = tmp_path / "ra.xlsx"
    assert "error[E2106]" in here("study", "import", str(study.path), str(file)).err
    file.write_bytes(b"PK\x03\x04\0\0")
    assert here("study", "import", str(study.path), str(file)).exit_code == 2
    for run in ("x", "0", "1.5"):
        said = here("study", "tell", str(study.path), run, "ra_um=0.3")
        assert (said.exit_code, f"'{run}' is no number of a run" in said.err) == (2, True)


def test_points_of_a_design_come_from_the_same_tables(tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    text = SMALL.replace(FULL, '[design]\nkind = "csv"\nfile = "points.csv"\norder = "standard"\n')
    for content in (
        "pulse.duty,servo.reference\n0.4,0.7\n0.2,0.8\n",
        "pulse.duty;servo.reference\n0,4;0,7\n0,2;0,8\n",
    ):
        file.write_text(content, encoding="utf-8")
        plan = plan_study(read_study(written(tmp_path, text))).plan
        assert [tuple(run.settings.values()) for run in plan.runs] == [(0.7, 0.4), (0.8, 0.2)]
    for content, says in (
        ("duty,servo.reference\n0.4,0.7\n", "no column pulse.duty in duty,servo.reference"),
        ("", "is empty"),
        ("pulse.duty,servo.reference\n0.4,0.9\n", r"line 2: reference = 0\.9 is not one of its values"),
        ("pulse.duty,servo.reference\n", "no row"),
        ("pulse.duty,servo.reference\n0,4,0,7\n", "line 2: 4 cells under a header of 2"),
        ("pulse.duty,pulse.duty,servo.reference\n0.2,0.4,0.7\n", "line 1: two columns are called pulse.duty"),
    ):
        file.write_text(content, encoding="utf-8")
        with pytest.raises(ProfileError, match=says):
            plan_study(read_study(written(tmp_path, text)))
    file.unlink()
    with pytest.raises(ProfileError, match="Cannot read"):
        plan_study(read_study(written(tmp_path, text)))


def test_a_value_is_withdrawn_and_reported_anew(tmp_path: Path, here: Here) -> None:
    folder = made(tmp_path, SMALL)
    run = folder.plan.runs[0]
    with folder.writer() as writer:
        writer.run(bare_row(run, 1, run.seed, datetime.now(UTC)))
    values = []
    for text in ("3.1", "none", "0.31"):
        said = here("study", "tell", str(folder.path), "1", f"ra_um={text}")
        assert ("is withdrawn" in said.out) == (text == "none")
        values.append(folder.read().run(1).value("ra_um"))
    assert values == [3.1, None, 0.31]
    with pytest.raises(UsageError, match="ra_um is given twice"):
        reported_values(folder.read(), ["ra_um=1", "ra_um=2"])
    table = tmp_path / "ra.csv"
    table.write_text("run,ra_um\n1,none\n", encoding="utf-8")
    imported = here("study", "import", str(folder.path), str(table))
    assert "Withdrawn: of 1 run, 1." in imported.out
    assert not folder.read().run(1).told


def test_a_value_of_an_earlier_attempt_is_refused(tmp_path: Path) -> None:
    folder = made(tmp_path, BOUNDED)
    first = folder.plan.runs[0]
    with folder.writer() as writer:
        for attempt in (1, 2):
            writer.run(bare_row(first, attempt, first.seed, datetime.now(UTC)))
    table = tmp_path / "filled.csv"
    table.write_text("run,attempt,ra_um\n1,1,0.3\n", encoding="utf-8")
    with pytest.raises(UsageError, match="The last attempt at run 1 is 2") as repeated:
        reported_table(folder.read(), table)
    assert repeated.value.code == "E2107"
    table.write_text("run,attempt,ra_um\n1,2,0.3\n", encoding="utf-8")
    assert reported_table(folder.read(), table) == {1: {"ra_um": 0.3}}
