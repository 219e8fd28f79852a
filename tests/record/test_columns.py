"""Records out of CSV and HDF5 files, and what is said about files that hold none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.app import main
from edmctl.errors import RecordError, RunFileError
from edmctl.record.columns import WANTED, read_columns, read_record, read_text, write_columns
from edmctl.record.delimited import Table
from edmctl.record.layout import SERVO
from edmctl.record.reader import open_run
from tests.report.made_up import a_cut, finished

ROWS = "0,1.5,-3\n0.005,2.5,-1.25e-1\n"
HEADER = "t_s,u_V,y_um\n"


def written(folder: Path, text: str | bytes, name: str = "record.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refused(path: Path) -> RecordError:
    with pytest.raises(RecordError) as refusal:
        read_record(path)
    assert refusal.value.exit_code == 3
    assert refusal.value.hint
    return refusal.value


@pytest.mark.parametrize(
    "text",
    [
        HEADER + ROWS,
        HEADER.encode() + ROWS.encode().rstrip(),
        b"\xef\xbb\xbf" + (HEADER + ROWS).replace("\n", "\r\n").encode(),
        (HEADER + ROWS).replace("\n", "\r"),
        (HEADER + ROWS).replace(",", ";"),
        (HEADER + ROWS).replace(",", ";").replace(".", ","),
        (HEADER + ROWS).replace(",", "\t"),
        "# a, b\n\n" + HEADER + "# more, of it\n" + ROWS + "\n# end\n",
        "# " + HEADER + ROWS,
        '"t_s", "u_V", "y_um"\n0,"1.5",-3\n0.005,2.5,-0.125 # last\n',
        "T_S,u_v,y_µm\n" + ROWS,
        "time_s,u_V,z_sensor_um\n" + ROWS,
        '"t_s","u_V","y_um","a, b"\n"0","1.5","-3",","\n"0.005","2.5","-0.125","7"\n',
        't_s;u_V;y_um;note\n0;1,5;-3;7" wafer\n0,005;2,5;-0,125;\n',
        "# Gerät\n".encode("latin-1") + (HEADER + ROWS).encode(),
        "y_um,note,t_s,u_V\n-3,-,0,1.5\n-0.125,late,0.005,2.5\n",
        "t_s,u_V,y_um,\n0,1.5,-3,\n0.005,2.5,-0.125,\n",
        HEADER + "0,1.5,-3,\n0.005,2.5,-0.125,\n",
        "Logger 7\nchannels,3\nstart,12.5\n\n" + HEADER + ROWS,
        "sep=;\n" + (HEADER + ROWS).replace(",", ";"),
        "sep=;\n" + (HEADER + ROWS).replace(",", ";").replace(".", ","),
        ("# " + HEADER + ROWS).replace(",", " "),
        ("# " + HEADER).replace(",", " ") + ROWS,
        (HEADER + ROWS).replace(",", "   ").replace(".", ","),
        "Model,MSO2024\nRecord Length,2\nVertical Units,V,V,V\n\n" + HEADER + "s,V,µm\n" + ROWS,
        HEADER + "(s),(V),(um)\n\n" + ROWS,
        "Logger\n3\n" + ("," + HEADER + "7," + ROWS.replace("\n0.005", "\n8,0.005")).replace(",", "\t"),
        ("," + HEADER + "," + ROWS.replace("\n0.005", "\n,0.005")).replace(",", "\t"),
    ],
)
def test_a_table_is_read_however_it_is_written(tmp_path: Path, text: str | bytes) -> None:
    record = read_record(written(tmp_path, text))
    np.testing.assert_array_equal(record.t_s, [0.0, 0.005])
    np.testing.assert_array_equal(record.u_v, [1.5, 2.5])
    np.testing.assert_array_equal(record.y_um, [-3.0, -0.125])
    assert record.y_um.flags.c_contiguous


def test_a_record_knows_its_file_and_leaves_numbers_to_the_checks(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + "0,1,nan\n1,inf,2\n", "morning.csv")
    record = read_record(path)
    assert (record.name, record.previous_v, read_record(path, 75.0).previous_v) == ("morning.csv", None, 75.0)
    assert np.isnan(record.y_um[0])
    assert np.isinf(record.u_v[1])


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("", "E3602", "is empty"),
        ("\n \n", "E3602", "is empty"),
        ("# nothing\n", "E3602", "comments only"),
        (b"PK\x03\x04\0\0\0", "E3602", "neither UTF-8 text nor HDF5"),
        ("t_s,u_V\n".encode("utf-16"), "E3602", "neither UTF-8 text nor HDF5"),
        (ROWS, "E3602", "no header"),
        ("1," * 1_000_000, "E3602", "a line of 2000000 characters"),
        (HEADER, "E3605", "holds 0 rows"),
        (HEADER + "0,1,2\n", "E3605", "holds 1 row"),
        ("t_s,t_s,u_V,y_um\n0,0,1,2\n", "E3603", "line 1: two columns are called t_s"),
        (",".join(f"column{k}" for k in range(5000)) + "\n1,2\n", "E3603", "no column t_s"),
    ],
)
def test_a_file_without_a_record_is_named(tmp_path: Path, text: str | bytes, code: str, message: str) -> None:
    error = refused(written(tmp_path, text))
    assert error.code == code
    assert message in error.message
    assert len(str(error)) < 400


SCOPE = "Model,MSO2024\nRecord Length,2\nVertical Units,V,V,V\n\n"


@pytest.mark.parametrize(
    ("text", "line", "missing"),
    [
        ("# c\nt_ms,u_V,y_um\n0,1,2\n1,2,3\n", 2, "t_s"),
        ("t_s,u_V\n0,1\n1,2\n", 1, "y_um"),
        (SCOPE + "TIME,CH1,CH2\n0,1,2\n1,2,3\n", 5, "t_s and no u_V and no y_um"),
        ("# t_s u_mV y_um\n0 1 2\n1 2 3\n", 1, "u_V"),
        ("t_s;u_V;stage\n0,0;1,5;2,5\n", 1, "y_um"),
        ("time\n", 1, "t_s and no u_V and no y_um"),
        ("# c\nt,u,y\ns,V,um\n0,1,2\n1,2,3\n", 2, "t_s and no u_V and no y_um"),
    ],
)
def test_a_missing_column_is_named_with_the_line_above_the_numbers(
    tmp_path: Path, text: str, line: int, missing: str
) -> None:
    error = refused(written(tmp_path, text))
    assert error.code == "E3603"
    assert f"line {line}: no column {missing} in " in error.message
    assert error.hint.startswith(f"Needed: {missing.split()[0]} (")
    assert "ename" not in error.hint
    assert error.where is not None
    assert error.where.line == line


@pytest.mark.parametrize(
    ("rows", "line", "column", "message", "remedy"),
    [
        ("0,1,2\n1,x,3\n", 4, 3, "column u_V: 'x' is no number", "Correct or delete"),
        ("0,1,2\n\n1,,3\n", 5, 3, "column u_V: the cell is empty", "Correct or delete"),
        ("ms,V,um\n0,1,2\n", 3, 1, "column t_s: 'ms' is no number", "Correct or delete"),
        ("0,1,2\n1\n2,3,4\n", 4, 1, "1 cell under a header of 3", "Complete or delete"),
        ("0,1,2\n1,2,\n", 4, 5, "column y_um: the cell is empty", "Correct or delete"),
        ("0,1,2\n1,2\n", 4, 1, "2 cells under a header of 3", "ends within a row"),
        ("0,0,1,5,2,5\n", 3, 1, "6 cells under a header of 3", "decimal point"),
        ("0,1,2\n0,5,1,2\n1,2\n", 4, 1, "4 cells under a header of 3", "decimal point"),
        ("0,1,2\n1,\u22125,3\n", 4, 3, "column u_V: '\u22125' is no number", "U+2212 (MINUS SIGN) is not"),
        ('0,"1",2\n1,2,"3\n4"\n', 5, 1, r"column y_um: '3\n4' is no number", "Correct or delete"),
        ('0,1,2\n1,"2\n",x\n', 5, 1, "column y_um: 'x' is no number", "Correct or delete"),
        ("0,1,2\n1_0,1,2\n", 4, 1, "column t_s: '1_0' is no number", "Correct or delete"),
    ],
)
def test_a_wrong_row_is_found(
    tmp_path: Path, rows: str, line: int, column: int, message: str, remedy: str
) -> None:
    error = refused(written(tmp_path, f"# c\n{HEADER}{rows}"))
    assert error.code == "E3604"
    assert message in error.message
    assert remedy in error.hint
    assert error.where is not None
    assert (error.where.line, error.where.column) == (line, column)


@given(st.text(alphabet='t_suVym0123456789.,;#"\n\t e-+٣µ\x00', max_size=80), st.booleans())
@settings(max_examples=300, deadline=None)
def test_any_text_is_read_or_refused(text: str, with_header: bool) -> None:
    content = (HEADER * with_header + text).encode()
    try:
        columns = read_text(content, "any.csv")
    except RecordError:
        return
    assert len({len(column) for column in columns.values()}) == 1


CELLS = st.sampled_from(
    ["0", "1.5", "-2e-3", "nan", "+inf", " 7 ", "5.", "", "x", "1_0", "0x1", "٣", '"1.5"', "2 # c", "#"]
)


@given(st.lists(st.lists(CELLS, min_size=2, max_size=5), max_size=4), st.sampled_from(",;\t "), st.booleans())
@settings(max_examples=500, deadline=None)
def test_the_fast_reader_takes_only_what_the_exact_one_takes(
    rows: list[list[str]], separator: str, with_commas: bool
) -> None:
    lines = [separator.join(row) for row in rows]
    if with_commas and separator != ",":
        lines = [line.replace(".", ",") for line in lines]
    table = Table("\n".join([separator.join(("t_s", "u_V", "y_um", "i_A")), *lines]), "any.csv", WANTED)
    try:
        fast = table._plain_numbers()
    except ValueError:
        return
    exact = [
        [table._number(line, name, text) for name, text in cells.items()]
        for line, cells in table.rows(numeric=True)
    ]
    np.testing.assert_array_equal(fast, exact)


def test_a_long_table_with_one_wrong_cell_names_its_line(tmp_path: Path) -> None:
    rows = [f"{0.005 * k:.3f},{k % 150},{k % 400}" for k in range(20_000)]
    rows[17_000] = "85.000,12,OVERRANGE"
    error = refused(written(tmp_path, HEADER + "\n".join(rows)))
    assert error.where is not None
    assert error.where.line == 17_002
    assert error.where.source_line == "85.000,12,OVERRANGE"


@pytest.mark.parametrize("name", ["v.csv", "v.h5"])
def test_a_voltage_needs_no_displacement_and_nothing_else_is_read(tmp_path: Path, name: str) -> None:
    write_columns(tmp_path / name, {"u_V": np.array([5.0, 6.0]), "t_s": np.array([0.0, 1.0])})
    t_s, u_v = read_columns(tmp_path / name, "t_s", "u_V")
    np.testing.assert_array_equal(t_s, [0.0, 1.0])
    np.testing.assert_array_equal(u_v, [5.0, 6.0])
    error = refused(tmp_path / name)
    assert "no column y_um" in error.message or "no dataset y_um" in error.message
    _, u_v = read_columns(written(tmp_path, HEADER + "0,1,x\n1,2,\n"), "t_s", "u_V")
    np.testing.assert_array_equal(u_v, [1.0, 2.0])


@pytest.mark.parametrize("name", ["gone.csv", "a\0b.csv", "x" * 5000, ""])
def test_a_file_that_is_not_there_or_a_folder_is_named(tmp_path: Path, name: str) -> None:
    assert refused(tmp_path / name).code == "E3601"


@pytest.mark.parametrize("name", ["columns.csv", "columns.h5"])
def test_written_columns_are_read_back_exactly_and_never_overwritten(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(1)
    t_s, u_v, y_um = np.cumsum(rng.random(50)), rng.normal(size=50), rng.normal(size=50)
    path = tmp_path / name
    columns = {"t_s": t_s, "u_V": u_v, "waveform": u_v, "y_um": y_um}
    write_columns(path, columns)
    before, record = path.read_bytes(), read_record(path)
    for read, stored in ((record.t_s, t_s), (record.u_v, u_v), (record.y_um, y_um)):
        np.testing.assert_array_equal(read, stored)
    with pytest.raises(RunFileError) as refusal:
        write_columns(path, columns)
    assert (refusal.value.code, path.read_bytes()) == ("E9011", before)
    with pytest.raises(RunFileError, match="No such file or directory") as refusal:
        write_columns(tmp_path / "none" / name, columns)
    assert refusal.value.code == "E9012"
    if name == "columns.h5":
        with h5py.File(path) as file:
            units = {name: file[name].attrs["units"] for name in file}
        assert units == {"t_s": "s", "u_V": "V", "waveform": "1", "y_um": "um"}


def hdf5(path: Path, **datasets: object) -> Path:
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file[name.replace("__", "/")] = values
    return path


@pytest.mark.parametrize(
    ("datasets", "message", "remedy"),
    [
        (
            {"t_s": [0.0, 1.0], "u_V": [0.0, 1.0], "y_mm": [0.0, 1.0]},
            "no dataset y_um",
            "Needed: y_um",
        ),
        ({}, "holds nothing", "Needed: t_s"),
        ({"t_s": [0.0, 1.0], "u_V": [0.0], "y_um": [0.0, 1.0]}, "u_V 1", "Every sample"),
        ({"t_s": [0.0, 1.0], "u_V": [[0.0], [1.0]], "y_um": [0.0, 1.0]}, "shape (2, 1)", "one column"),
        ({"t_s": ["a", "b"], "u_V": [0.0, 1.0], "y_um": [0.0, 1.0]}, "no dataset of numbers", "floats"),
        ({f"a__{name}": [0.0, 1.0] for name in ("t_s", "u_V", "y_um")}, "holds nothing", "Needed: t_s"),
    ],
)
def test_hdf5_without_one_set_of_columns_is_refused(
    tmp_path: Path, datasets: dict[str, object], message: str, remedy: str
) -> None:
    error = refused(hdf5(tmp_path / "x.h5", **datasets))
    assert error.code == "E3606"
    assert message in error.message
    assert remedy in error.hint


def test_hdf5_without_samples_or_damaged_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    assert refused(hdf5(path, t_s=[0.0], u_V=[0.0], y_um=[0.0])).code == "E3605"
    path = hdf5(path, t_s=[0.0, 1.0], u_V=h5py.Empty("f8"), y_um=[0.0, 1.0])
    assert "shape None" in refused(path).message
    with h5py.File(path, "a") as file:
        del file["u_V"]
        file["u_V"] = h5py.SoftLink("/gone")
    assert refused(path).code == "E3606"
    hdf5(path, **{name: np.zeros(1000) for name in ("t_s", "u_V", "y_um")})
    cut = written(tmp_path, path.read_bytes()[: path.stat().st_size // 2], "cut.h5")
    text = written(tmp_path, HEADER + ROWS, "text.h5")
    assert [refused(cut).code, refused(text).code] == ["E3606", "E3606"]


@pytest.mark.parametrize("name", ["run.h5", "run.dat", "run.csv", "run", "run.h5.partial"])
def test_any_run_is_a_record_whatever_its_name(write_run: Callable[[str], Path], name: str) -> None:
    record = read_record(write_run(name))
    with open_run(write_run("other.h5")) as run:
        servo = run.columns(SERVO.path)
    assert record.t_s.dtype == record.y_um.dtype == np.float64
    np.testing.assert_array_equal(record.t_s, servo["time"])
    np.testing.assert_array_equal(record.u_v, servo["v_cmd"])
    np.testing.assert_array_equal(record.y_um, servo["z_sensor"])


def test_an_exported_servo_table_is_known_by_its_columns(run_path: Path) -> None:
    table = run_path.with_name("servo.csv")
    assert main(["run", "export", str(run_path), "--table", "servo", "--out", str(table)]) == 0
    exported, direct = read_record(table), read_record(run_path)
    for name in ("t_s", "y_um", "u_v"):
        np.testing.assert_allclose(getattr(exported, name), getattr(direct, name))


def test_what_else_edmctl_writes_is_named_for_what_it_is(tmp_path: Path, run_path: Path) -> None:
    blind = finished(tmp_path, replace(a_cut(5.0), sensor_um=np.full(500, np.nan)), name="blind.h5")
    cut = written(tmp_path, run_path.read_bytes()[:-5000], "cut.h5")
    with h5py.File(run_path, "r+") as later:
        later.attrs["schema"] = "edmctl-run/99"
    for path, code, what in (
        (blind, "E3606", "without a displacement sensor"),
        (run_path, "E3606", "later version"),
        (cut, "E3606", "is damaged"),
        (written(tmp_path, 'schema = "edmctl-calibration/1"\n', "a.toml"), "E3603", "no column t_s"),
    ):
        error = refused(path)
        assert (error.code, what in str(error)) == (code, True), error
