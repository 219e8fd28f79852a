from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from edmctl.app import main
from edmctl.record.rows import RunMeta
from edmctl.record.writer import RunWriter
from tests.golden import once
from tests.record.samples import a_meta, fill


@pytest.fixture
def meta() -> RunMeta:
    return a_meta()


@pytest.fixture
def write_run(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Put a complete run file of the given name into the test's folder and return its path."""

    def make(folder: Path) -> None:
        writer = RunWriter.create(folder / "run.h5", a_meta())
        fill(writer)
        writer.finish("done", 0)

    def write(name: str) -> Path:
        made = once(tmp_path_factory, "made-up-run", make) / "run.h5"
        return Path(shutil.copyfile(made, tmp_path / name))

    return write


@pytest.fixture
def run_path(write_run: Callable[[str], Path]) -> Path:
    return write_run("run.h5")


@pytest.fixture(scope="session")
def real_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file `run.h5` of a short job on the virtual machine, with every pulse in it."""

    def machine(folder: Path) -> None:
        profile = Path(__file__).parents[2] / "profiles" / "cu270.toml"
        job = ["--set", "target.depth_um=8", "--set", 'log.pulses="full"', "--seed", "3", "--quiet"]
        with pytest.MonkeyPatch.context() as patch:
            for name in ("EDMCTL_PROFILE", "EDMCTL_PORT", "EDMCTL_CALIBRATION"):
                patch.delenv(name, raising=False)
            patch.setenv("EDMCTL_HOME", str(folder / "home"))
            out = ["--out", str(folder), "--run-id", "run"]
            assert main(["machine", "--profile", str(profile), *job, *out]) == 0

    return once(tmp_path_factory, "real-run", machine) / "run.h5"
