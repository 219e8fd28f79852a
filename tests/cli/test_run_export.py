"""`edmctl run export`: every number as it is in the file, for programs that read CSV, JSON and Parquet."""

from __future__ import annotations

import csv
import errno
import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from edmctl.errors import RunFileError, UsageError, installing
from edmctl.jobs.output_files import new_file
from edmctl.jobs.runs.outputs import export_request
from edmctl.record.reader import open_run
from edmctl.record.rows import ServoBlock
from edmctl.report.export import TABLES, CsvWriter, ExportTable, formatted
from edmctl.results.telemetry import PulseBlockBatch
from tests.cli.commands import Here, command, environment
from tests.cli.run_files import begun, killed
from tests.record.samples import finished as made_up

ODD = np.array([np.nan, 0.1, -1.1754944e-38, 16777217.0, 1e-7, 3.4028235e38], "f4")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run whose servo rows end with numbers that are easily spoilt."""
    writer = begun(tmp_path, "one")
    time_s = 10.0 + 0.1 * np.arange(len(ODD))
    zeros = np.zeros(len(ODD), np.int8)
    writer.append(ServoBlock(time_s, ODD, ODD, ODD, ODD, ODD, ODD, zeros, zeros))
    return writer.finish("done", 0)


def columns_of(text: str) -> dict[str, list[str]]:
    header, *rows = csv.reader(io.StringIO(text))
    return {name: [row[k] for row in rows] for k, name in enumerate(header)}


def test_csv_is_read_back_to_the_last_bit(here: Here, run: Path) -> None:
    said = here("run", "export", str(run), "--table", "servo")
    assert (said.exit_code, said.err) == (0, "")
    columns = columns_of(said.out)
    with open_run(run) as opened:
        for column in TABLES["servo"].columns:
            name = {"time": "time_s", "z_sensor": "z_sensor_um", "v_cmd": "v_cmd_v"}.get(column.name)
            if name is not None:
                read = np.array([float(cell or "nan") for cell in columns[name]]).astype(column.dtype)
                assert read.tobytes() == opened.column("/entry/servo", column.name).tobytes()
    assert columns["z_sensor_um"][1000] == ""
    assert len(columns["time_s"]) == 1006


def test_pulses_have_their_times_and_plain_units(here: Here, run: Path) -> None:
    columns = columns_of(here("run", "export", str(run), "--table", "pulses").out)
    assert list(columns) == ["time_s", "pulse_class", "td_us", "te_us", "u_v"]
    with open_run(run) as opened:
        assert [float(cell) for cell in columns["time_s"]] == opened.pulse_times_s().tolist()
    assert [float(cell) for cell in columns["td_us"][:4]] == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_results_of_a_simulated_run_have_its_truth(here: Here, run_file: Path) -> None:
    columns = columns_of(here("run", "export", str(run_file), "-t", "results").out)
    document = here("run", "show", str(run_file), "--json").document
    (site,) = document["result"]["summary"]["sites"]
    for name in ("depth_um", "wear_um"):
        assert [float(cell) for cell in columns[f"truth_{name}"]] == pytest.approx(
            [site["truth"][name]], abs=1e-3
        )


def test_texts_and_unknown_values_keep_their_form(here: Here, run: Path) -> None:
    def exported(*options: str) -> str:
        return here("run", "export", str(run), *options).out

    columns = columns_of(exported("--table", "events"))
    assert columns["message"] == ['Cut 1: "feed", then touch']
    assert columns["name"] == ["CUT_PLANNED"]
    assert json.loads(columns["args"][0]) == {"cut": 1, "feed_um": 20.5}
    rows = json.loads(exported("-t", "servo", "--format", "json"))
    assert rows[1000]["z_sensor_um"] is None
    assert np.float32(rows[1001]["z_sensor_um"]) == np.float32(0.1)
    (event,) = json.loads(exported("-t", "events", "--format", "json"))
    assert event["args"] == {"cut": 1, "feed_um": 20.5}
    assert json.loads(exported("-t", "link", "--format", "json")) == []
    lines = exported("-t", "slow", "--format", "jsonl").splitlines()
    assert [json.loads(line)["time_s"] for line in lines] == pytest.approx([0.1 * k for k in range(30)])


@pytest.mark.needs("pyarrow")
def test_parquet_keeps_types_units_and_numbers(here: Here, run: Path, tmp_path: Path) -> None:
    from pyarrow import parquet

    out = tmp_path / "servo.parquet"
    assert here("run", "export", str(run), "-t", "servo", "-o", str(out)).exit_code == 0
    table = parquet.read_table(out)
    field = table.schema.field("z_sensor_um")
    assert field.metadata[b"units"] == b"um"
    assert str(field.type) == "float"
    assert table.schema.metadata[b"run_id"] == b"one"
    with open_run(run) as opened:
        stored = opened.column("/entry/servo", "z_sensor")
    assert table["z_sensor_um"].to_numpy().tobytes() == stored.tobytes()


@pytest.mark.needs("pyarrow")
def test_every_column_of_every_table_goes_to_every_format(here: Here, run: Path, tmp_path: Path) -> None:
    for form in ("csv", "json", "jsonl", "parquet"):
        said = here("run", "export", str(run), "--format", form, "-o", str(tmp_path / form), "--json")
        assert said.exit_code == 0
        tables = {table["table"]: table for table in said.document["result"]["tables"]}
        assert {"servo", "slow", "pulses", "segments", "events", "touches", "results"} <= set(tables)
        assert "link" not in tables
        assert tables["pulses"]["rows"] == 300
        for name, table in tables.items():
            assert (tmp_path / form / f"one-{name}.{form}").stat().st_size == table["size_bytes"]
            assert len(set(table["columns"])) == len(table["columns"])


def test_without_a_place_files_stand_beside_the_run_and_nothing_is_overwritten(here: Here, run: Path) -> None:
    there = run.parent / "one-results.csv"
    there.write_text("mine")
    said = here("run", "export", str(run))
    assert (said.exit_code, "E9011" in said.err) == (9, True)
    assert "--overwrite" in said.err
    assert there.read_text() == "mine"
    assert not (run.parent / "one-servo.csv").exists()
    there.unlink()
    said = here("run", "export", str(run))
    assert (said.exit_code, str(there) in said.out) == (0, True)
    assert (run.parent / "one-servo.csv").exists()
    folder = run.parent / "run.v2"
    folder.mkdir()
    assert here("run", "export", str(run), "-t", "touches", "-o", str(folder)).exit_code == 0
    assert (folder / "one-touches.csv").exists()


@pytest.mark.parametrize(
    ("code", "tables", "form", "out", "as_json"),
    [
        ("E2080", ["srevo"], None, None, False),
        ("E2081", [], "xlsx", None, False),
        ("E2081", [], None, "touches.xlsx", False),
        ("E2081", ["touches"], "csv", "touches.xlsx", False),
        ("E2082", [], None, "-", False),
        ("E2082", ["servo", "slow"], None, "both.csv", False),
        ("E2083", ["servo"], None, None, True),
        ("E2084", ["servo"], "json", "servo.csv", False),
    ],
)
def test_what_cannot_be_meant_is_refused(
    code: str, tables: list[str], form: str | None, out: str | None, as_json: bool
) -> None:
    with pytest.raises(UsageError) as refused:
        export_request("one", Path(), list(TABLES), tables, form, Path(out) if out else None, as_json=as_json)
    assert refused.value.code == code
    assert code != "E2080" or "Did you mean servo?" in refused.value.hint


def test_a_file_is_replaced_where_that_is_wanted_and_stays_where_it_fails(
    here: Here, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = run.parent / "one-results.csv"
    command = ("run", "export", str(run), "-t", "results", "-o", str(there), "--overwrite")
    there.write_text("mine")
    said = here(*command)
    assert (said.exit_code, said.err) == (0, "")
    assert there.read_text().startswith("site,")
    there.write_text("mine")
    monkeypatch.setattr("edmctl.jobs.output_files._opened", lambda path: FullDisk())
    assert here(*command).exit_code == 9
    assert there.read_text() == "mine"


def test_a_log_that_the_run_did_not_keep_leads_to_the_one_it_kept(here: Here, tmp_path: Path) -> None:
    counts = np.array([5, 6])
    sums = PulseBlockBatch(
        np.array([0.0, 0.01]), counts, counts, counts, counts, delay_us=counts * 1.0, energy_uj=counts * 2.0
    )
    run = made_up(tmp_path / "sums.h5", sums)
    said = here("run", "export", str(run), "-t", "pulses")
    assert (said.exit_code, len(said.out.splitlines())) == (0, 1)
    assert "-t blocks" in said.err
    assert here("run", "export", str(run), "-t", "blocks").err == ""


def test_parquet_without_its_library_says_how_to_get_it(
    here: Here, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    said = here("run", "export", str(run), "--format", "parquet")
    assert said.exit_code == 8
    assert "E8092" in said.err
    assert f"Install it: {installing('pyarrow')}" in said.err


def test_a_killed_run_is_refused_and_a_live_one_is_not(here: Here, tmp_path: Path) -> None:
    said = here("run", "export", str(killed(tmp_path, "dead")), "-t", "results")
    assert (said.exit_code, said.out) == (9, "")
    assert "E9008" in said.err
    writer = begun(tmp_path, "living")
    said = here("run", "export", str(tmp_path / "living.h5.partial"), "-t", "servo")
    writer.finish("done", 0)
    assert said.exit_code == 0
    assert len(said.out.splitlines()) == 1001


class FullDisk(io.BytesIO):
    """Takes nothing."""

    def write(self, data: object, /) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("form", ["csv", pytest.param("parquet", marks=pytest.mark.needs("pyarrow"))])
def test_a_full_disk_is_an_error_and_leaves_no_part_of_a_file(
    here: Here, run: Path, tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edmctl.jobs.output_files._opened", lambda path: FullDisk())
    said = here("run", "export", str(run), "--format", form, "-o", str(tmp_path / "out"))
    assert said.exit_code == 9
    assert "E9012" in said.err
    assert "No space left on device" in said.err
    assert list((tmp_path / "out").iterdir()) == []


def test_a_failure_leaves_no_part_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "part.csv"
    with pytest.raises(TypeError), new_file(path) as sink:
        sink.write(b"begun" + None)  # type: ignore[operator]
    assert not path.exists()
    path.write_text("mine")
    with pytest.raises(RunFileError, match="exists already"), new_file(path):
        pass
    assert path.read_text() == "mine"


def test_a_reader_that_goes_away_is_no_failure(run: Path, tmp_path: Path) -> None:
    with subprocess.Popen(
        command("run", "export", str(run), "--table", "servo"),
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 0


def test_numbers_are_the_shortest_texts_of_their_type() -> None:
    values = np.array([52.5925, np.nan, -0.0, 1e-7], "f4")
    assert formatted(values, unknown="") == ["52.5925", "", "-0.0", "1e-07"]


def test_rows_come_in_blocks(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edmctl.report.export.BLOCK_ROWS", 100)
    with open_run(run) as opened:
        table = ExportTable(opened, "servo", {})
        assert [len(block[0]) for block in table.blocks()] == [100] * 10 + [6]
        whole = io.BytesIO()
        writer = CsvWriter(whole, table.columns)
        for block in table.blocks():
            writer.write(block)
    assert whole.getvalue().count(b"\n") == 1007
