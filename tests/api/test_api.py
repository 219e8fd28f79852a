"""The Python API: the same jobs as those of the command line, without any of it."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
from typing import TYPE_CHECKING

import pytest

import edmctl
from edmctl.errors import Interrupted, ProfileError
from edmctl.machine.stop import StopRequest
from tests.cli.commands import ROOT

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.jobs.job import Report
    from tests.cli.commands import Here

SHALLOW = {"target.depth_um": 8, "log.pulses": "off"}
EXAMPLES = re.findall(
    r"^```python\n(.*?)^```$", (ROOT / "docs/python.md").read_text(encoding="utf-8"), re.S | re.M
)


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_of_the_page_works(example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "docs/python.md", "exec"), {"__name__": "example"})


def test_importing_loads_nothing_heavy() -> None:
    look = "import sys, edmctl; print(' '.join(sorted(sys.modules)))"
    told = subprocess.run([sys.executable, "-c", look], check=True, capture_output=True, text=True, cwd=ROOT)
    loaded = told.stdout.split()
    assert [name for name in loaded if name.startswith("edmctl.")] == ["edmctl.version"]
    assert not {"numpy", "numba", "h5py", "pydantic", "typer", "rich", "scipy"} & set(loaded)


def test_a_result_is_that_of_the_command(here: Here) -> None:
    report = edmctl.connect("sim:", seed=4).machine("cu270", overrides=SHALLOW)
    said = here(
        *("machine", "-p", "cu270", "--seed", "4", "--json", "--quiet"),
        *("--set", "target.depth_um=8", "--set", 'log.pulses="off"'),
    )
    assert json.dumps(report.to_dict(), sort_keys=True) == json.dumps(said.document["result"], sort_keys=True)


def test_threads_do_not_disturb_each_other() -> None:
    alone = {seed: machined(seed) for seed in range(4)}
    together: dict[int, Report] = {}

    def work(seed: int) -> None:
        together[seed] = machined(seed)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in alone]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed, report in alone.items():
        assert json.dumps(together[seed].to_dict()) == json.dumps(report.to_dict())


def machined(seed: int) -> Report:
    return edmctl.connect("sim:", seed=seed).machine("cu270", overrides=SHALLOW)


def test_a_grid_is_worked_off_in_its_order() -> None:
    sweep: dict[str, list[float]] = {"target.depth_um": [6, 8], "servo.reference": [0.75]}
    reports = edmctl.simulate("cu270", seeds=[1, 2], sweep=sweep, overrides=['log.pulses="off"'])
    assert [round(report.sites[0].depth_um, -0) for report in reports] == [6, 6, 8, 8]


def test_a_wrong_profile_is_raised_before_anything_runs() -> None:
    with pytest.raises(ProfileError):
        edmctl.simulate("cu270", seeds=[1], sweep={"target.depth_um": [8, -1]})


def test_a_stop_ends_a_job_in_order_and_is_told_by_its_report() -> None:
    stop = StopRequest()

    class Watch:
        def progress(self, p: object) -> None:
            stop.request(signal.SIGTERM)

        def note(self, text: str) -> None:
            """Ignore it."""

    report = edmctl.connect("sim:", seed=1).machine("cu270", overrides=SHALLOW, observer=Watch(), stop=stop)
    assert isinstance(report.error, Interrupted)
    with pytest.raises(Interrupted):
        report.raise_for_error()


def test_a_report_shows_itself_in_a_notebook() -> None:
    report = machined(1)
    assert re.fullmatch(r"<Report: depth \d+\.\d+ ± \d+\.\d+ µm>", repr(report))
    assert "<td>cu270-cu</td>" in report._repr_html_()
    frame = report.to_frame()
    assert frame["depth_um"][0] == pytest.approx(report.sites[0].depth_um, abs=1e-3)
    assert "truth_wear_um" in frame


def test_a_name_that_is_not_there_is_told() -> None:
    with pytest.raises(AttributeError, match="no attribute 'machines'"):
        edmctl.machines  # noqa: B018
    assert "connect" in dir(edmctl)
