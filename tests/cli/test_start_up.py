"""Start-up stays light: what loads is asserted on modules, not on milliseconds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from edmctl.version import __version__
from tests.cli.commands import environment, in_process_of_its_own

HEAVY = {"numpy", "scipy", "numba", "h5py", "pydantic", "matplotlib"}
"""typer 0.29 loads pydantic for every command with options: hence the bound in pyproject.toml. Help loads rich."""


def modules_after(arguments: list[str], cwd: Path) -> set[str]:
    code = (
        "import sys\n"
        f"sys.argv = ['edmctl', *{arguments!r}]\n"
        "from edmctl.__main__ import main\n"
        "def report(code=0):\n"
        "    sys.stderr.write('MODULES ' + ' '.join(sys.modules))\n"
        "    sys.stderr.flush()\n"
        "    leave(0)\n"
        "import os\n"
        "leave, os._exit = os._exit, report\n"
        "main()\n"
        "report()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=cwd,
        env=environment(),
        capture_output=True,
        encoding="utf-8",
        check=True,
    )
    return set(done.stderr.rpartition("MODULES ")[2].split())


def test_version_loads_no_typer(tmp_path: Path) -> None:
    assert not modules_after(["--version"], tmp_path) & {"typer", "click", "typer._click", *HEAVY}


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["machine", "--help"],
        ["calibrate", "--help"],
        ["simulate", "--help"],
        ["simulate", "actuator", "--help"],
        ["profile", "check", "--help"],
        ["study", "--help"],
        ["nonsense"],
    ],
)
def test_help_and_usage_errors_load_nothing_heavy(arguments: list[str], tmp_path: Path) -> None:
    assert not modules_after(arguments, tmp_path) & HEAVY


def test_checking_a_profile_needs_neither_plant_nor_run_file(tmp_path: Path) -> None:
    loaded = modules_after(["machine", "--profile", "cu270", "--dry-run", "--json"], tmp_path)
    assert not loaded & {"numpy", "numba", "h5py", "rich"}


def test_a_job_for_a_script_loads_neither_rich_nor_scipy_beyond_its_name(tmp_path: Path) -> None:
    job = ["machine", "-p", "cu270", "--quiet", "--seed", "1", "--set", "target.depth_um=8", "--json"]
    loaded = modules_after(job, tmp_path)
    assert "numpy" in loaded
    assert not loaded & {"numba", "rich", "scipy.linalg", "scipy.optimize"}


def test_the_state_of_a_study_loads_no_scipy_and_no_machine(tmp_path: Path) -> None:
    loaded = modules_after(["study", "status", "none"], tmp_path)
    assert not loaded & {"scipy.special", "edmctl.jobs.job", "edmctl.simulator"}


def test_a_job_loads_only_what_it_uses(tmp_path: Path) -> None:
    job = ["machine", "-p", "cu270", "--quiet", "--seed", "1", "--set", "target.depth_um=8"]
    unused = {
        "edmctl.actuator.identification",
        "edmctl.cli.commands.calibrate",
        "edmctl.cli.commands.run",
        "edmctl.study.commands",
        "edmctl.procedures.channel.procedure",
        "edmctl.procedures.hole.resuming",
        "edmctl.profile.calibration",
        "edmctl.results.run_file",
        "edmctl.study.results",
    }
    assert not modules_after(job, tmp_path) & unused


def test_version_is_said(tmp_path: Path) -> None:
    said = in_process_of_its_own("--version", cwd=tmp_path)
    assert (said.exit_code, said.out) == (0, f"edmctl {__version__}\n")


INTERRUPTED_IMPORT = """
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "edmctl.app":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupting())
"""
INTERRUPTED_RUN = """
import edmctl.app
def interrupted():
    raise KeyboardInterrupt
edmctl.app.raising_signals = interrupted
"""


@pytest.mark.parametrize("interruption", [INTERRUPTED_IMPORT, INTERRUPTED_RUN], ids=["import", "run"])
def test_ctrl_c_before_signals_are_handled_is_no_traceback(interruption: str, tmp_path: Path) -> None:
    code = (
        f"import sys\n{interruption}\n"
        "from edmctl.__main__ import main\n"
        "sys.argv = ['edmctl', 'profile', 'show', 'cu270']\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (-2, "", "")


def test_a_worker_of_an_unguarded_launcher_does_not_run_the_command_again(tmp_path: Path) -> None:
    script = tmp_path / "launch.py"
    script.write_text(
        "import multiprocessing, sys\n"
        "from edmctl.__main__ import main\n"
        "sys.argv = ['edmctl', '--version']\n"
        "if multiprocessing.current_process().name == 'MainProcess':\n"
        "    worker = multiprocessing.get_context('spawn').Process(target=print, args=('worked',))\n"
        "    worker.start()\n"
        "    worker.join()\n"
        "main()\n",
        encoding="utf-8",
    )
    done = subprocess.run(
        [sys.executable, str(script)], env=environment(), capture_output=True, encoding="utf-8", check=True
    )
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["worked", "edmctl"]
