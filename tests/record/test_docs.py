"""docs/run-file.md is true."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from edmctl.errors import MEANING
from edmctl.labels import Verdict
from edmctl.record import layout
from edmctl.record.reader import open_run
from edmctl.record.writer import RunWriter
from edmctl.results.declared import PURE
from tests.record.samples import a_meta, slow_row

if TYPE_CHECKING:
    from collections.abc import Callable

    Example = Callable[[str], list[str]]

PAGE = (Path(__file__).parents[2] / "docs" / "run-file.md").read_text(encoding="utf-8")
EXAMPLES = dict(
    re.findall(r"^<!-- example: (\w+) -->\n```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
)
(MATLAB,) = re.findall(r"^```matlab\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
JUMP = 122


@pytest.fixture
def example(real_run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Example:
    """Run an example of the page beside the file of a real job; return the lines that it prints."""
    monkeypatch.chdir(real_run.parent)

    def run(name: str) -> list[str]:
        exec(compile(EXAMPLES[name], f"run-file.md, {name}", "exec"), {})
        return capsys.readouterr().out.splitlines()

    return run


def test_every_example_has_a_test() -> None:
    assert PAGE.count("```python") == len(EXAMPLES)
    here = Path(__file__).read_text(encoding="utf-8")
    tested = re.findall(r"(?:example\(|EXAMPLES\[)[\"'](\w+)[\"']", here)
    assert sorted(tested) == sorted(EXAMPLES)


def test_the_seal_is_found_to_fit_and_not_to(tmp_path: Path, real_run: Path) -> None:
    content = bytearray(real_run.read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "run.h5").write_bytes(content)
    check = EXAMPLES["seal"]
    assert subprocess.check_output([sys.executable, "-c", check], cwd=real_run.parent) == b"sound\n"
    assert subprocess.check_output([sys.executable, "-c", check], cwd=tmp_path) == b"damaged\n"


def test_examples_of_edmctl_h5py_events_and_pulses_read_what_is_there(
    example: Example, real_run: Path
) -> None:
    with open_run(real_run) as run:
        time_s, gap_v = run.column("/entry/servo", "time"), run.column("/entry/servo", "v_gap_avg")
        row, events = run.table("/entry/results")[0], run.table("/entry/events")
        pulses_s, delay_us = run.pulse_times_s(), run.column("/entry/pulses/full", "td")
        normal = run.column("/entry/pulses/full", "pulse_class") == 1
    assert example("h5py") == [
        f"done {time_s[-1]:.1f} s, mean gap voltage {gap_v.mean():.1f} V",
        f"cu270-cu depth {row['depth']:.2f} ± {row['depth_u95']:.2f} µm",
        f"tool wear {row['wear']:.2f} ± {row['wear_u95']:.2f} µm",
    ]
    jumps = events[events["code"] == JUMP]
    lines = example("events")
    assert len(lines) == len(jumps) > 0
    height_um = json.loads(jumps[0]["args"])["height_um"]
    assert lines[0].startswith(f"{jumps[0]['time']:.1f} s: Jump of ")
    assert lines[0].endswith(f"({height_um:.1f} µm)")
    assert example("pulses") == [
        f"{len(pulses_s)} pulses from {pulses_s[0]:.3f} s to {pulses_s[-1]:.3f} s",
        f"mean ignition delay of normal discharges {delay_us[normal].mean(dtype='f8'):.1f} µs",
    ]
    last = f"{len(pulses_s)} pulses, the last at {pulses_s[-1]:.3f} s"
    assert example("edmctl") == [last, "done 8.0"]
    depth, command, keys = example("profile")
    assert depth == "depth wanted: 8.0 um"
    assert command.startswith("command: edmctl")
    assert len(json.loads(keys.replace("'", '"'))) == 3


def test_pandas_reads_touches_and_moments(example: Example, real_run: Path) -> None:
    lines = example("pandas")
    with open_run(real_run) as run:
        touches, start = run.table("/entry/touches"), run.text("/entry/start_time")
    assert [line.split()[2] for line in lines[1:-1]] == [kind.decode() for kind in touches["kind"]]
    assert {line.split()[3] for line in lines[1:-1]} == {"cu270-cu"}
    assert lines[-1].startswith(f"last sample at {start[:10]}T")
    assert lines[-1].endswith(start[-6:])


@pytest.mark.needs("xarray")
def test_xarray_reads_the_slow_columns(example: Example, real_run: Path) -> None:
    with open_run(real_run) as run:
        slow = run.columns("/entry/slow", ["time", "r_arc"])
    sizes, mean = example("xarray")
    assert sizes == f"um Frozen({{'time': {len(slow['time'])}}})"
    assert float(mean) == pytest.approx(slow["r_arc"][np.less_equal(slow["time"], 100)].mean(), rel=1e-5)


@pytest.mark.needs("nexusformat", "silx")
def test_viewers_find_the_plots(example: Example, real_run: Path) -> None:
    with open_run(real_run) as run:
        first_line = run.text("/entry/profile/toml").splitlines()[0]
    assert example("nexusformat") == ["/entry/data z_sensor um over time", first_line]
    assert example("silx") == ["mean gap voltage V ['time since start']"]


def test_a_live_run_is_followed_to_its_end(tmp_path: Path) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", a_meta())
    writer.append(slow_row(20))
    writer.flush()
    impatient = f"import time\ntime.sleep = lambda s: None\n{EXAMPLES['live']}"
    with subprocess.Popen(
        [sys.executable, "-c", impatient], cwd=tmp_path, stdout=subprocess.PIPE, encoding="utf-8"
    ) as follower:
        assert follower.stdout is not None
        first = follower.stdout.readline()
        writer.append(slow_row(40))
        writer.finish("done", 0)
        rest = follower.communicate(timeout=60)[0]
    assert (first, rest) == ("2.0 s: 2.0 µm\n", "4.0 s: 4.0 µm\n")
    assert follower.returncode == 0


def test_matlab_reads_what_is_there(real_run: Path) -> None:
    with h5py.File(real_run) as file:
        read = re.findall(r'(?:h5read|h5info)\(file, "([^"]+)"\)|text\("([^"]+)"\)', MATLAB)
        assert len(read) > 12
        for path, text_path in read:
            assert path in file or text_path in file
        for path, attribute in re.findall(r'h5readatt\(file, "([^"]+)", "([^"]+)"\)', MATLAB):
            assert attribute in file[path].attrs
        for table in ("results", "touches", "events"):
            fields = set(re.findall(rf"\b{table}\.(\w+)", MATLAB))
            assert fields
            assert fields <= set(file[f"/entry/{table}"].dtype.names)
        for path in re.findall(r'text\("([^"]+)"\)', MATLAB):
            assert file[path].dtype.kind == "S"
        assert file["/entry/summary"].dtype == np.uint8
        assert file["/entry/pulses/full/td"].attrs["units"] == "0.1 us"
        assert JUMP in file["/entry/events"]["code"]


def test_paths_times_and_form_of_a_complete_file_are_those_of_the_page(real_run: Path) -> None:
    form = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d"
    superblock_version = 8
    assert real_run.read_bytes()[superblock_version] == 0, "old libraries read it"
    with h5py.File(real_run) as file:
        assert {path for path in re.findall(r"/entry(?:/\w+)*", PAGE) if path not in file} == set()
        start, end = (file[f"/entry/{name}_time"].asstr()[()] for name in ("start", "end"))
        assert re.fullmatch(form, start)
        assert re.fullmatch(form, end)
        assert file["/entry/servo/time"].attrs["start"] == start


def test_each_status_stands_there_with_its_exit_code() -> None:
    rows = re.findall(r"^\| `([^`]+)` \| (\d+) \|", PAGE, re.MULTILINE)
    meaning = {str(int(code)): text.partition(" (")[0] for code, text in MEANING.items()}
    never_in_a_finished_file = {"2", "3", "9"}
    expected = {(text, code) for code, text in meaning.items() if code not in never_in_a_finished_file}
    assert set(rows) == expected | {(str(Verdict.NOT_SHOWN), "7")}


def test_the_line_that_decodes_the_summary_runs(run_path: Path) -> None:
    (line,) = re.findall(r"`(json\.loads\([^`]*)`", PAGE)
    with h5py.File(run_path) as run:
        assert eval(line, {"json": json, "run": run}) == {"ok": True}


def test_only_whole_numbers_are_stored_in_steps() -> None:
    stepped = {
        (table.path, column.name)
        for table in layout.TABLES
        for column in table.columns
        if column.step != 1.0 or (column.units[:1].isdigit() and column.units != PURE)
    }
    assert stepped == {("/entry/pulses/full", name) for name in ("td", "te", "u")}
