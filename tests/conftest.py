"""Settings of all tests."""

from __future__ import annotations

import os
import signal
import sys
import zlib
from tempfile import TemporaryDirectory

import pytest
from hypothesis import settings

from edmctl.core.build import CACHE_VARIABLE
from edmctl.start_up import spare_start_up
from tests.cli.commands import Here
from tests.needs import skip_without

# A busy machine is no failure, the same tree gives the same examples, and nothing is left in the tree.
settings.register_profile("edmctl", deadline=None, derandomize=True, database=None)
settings.load_profile("edmctl")

# As a command does: threads of BLAS that wait for each other cost more than half of the time of a fit.
spare_start_up()

# Whoever starts the tests may ignore signals (nohup does); the processes that tests start would inherit that.
for _name in ("SIGINT", "SIGTERM", "SIGHUP"):
    _number = getattr(signal, _name, None)
    if _number is not None and signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _name == "SIGINT" else signal.SIG_DFL)


def pytest_configure(config: pytest.Config) -> None:
    """Share builds of the firmware among all workers, and bytecode among the processes that tests start.

    A folder for builds that is named already is kept. With PYTHONDONTWRITEBYTECODE each of these processes would
    compile all that it imports.
    """
    if hasattr(config, "workerinput"):
        if "PYTHONPYCACHEPREFIX" in os.environ:
            sys.pycache_prefix, sys.dont_write_bytecode = None, True
        return
    if not os.environ.get(CACHE_VARIABLE):
        builds = TemporaryDirectory(prefix="edmctl-firmware-")
        os.environ[CACHE_VARIABLE] = builds.name
        config.add_cleanup(builds.cleanup)
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None) is not None:
        bytecode = TemporaryDirectory(prefix="edmctl-bytecode-")
        os.environ["PYTHONPYCACHEPREFIX"] = bytecode.name
        config.add_cleanup(bytecode.cleanup)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add an option for a sample of the tests."""
    parser.addoption("--sample", type=int, default=1, metavar="N", help="run one test of N, by its name")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not in the sample."""
    if (sample := config.getoption("--sample")) > 1:
        items[:] = [item for item in items if zlib.crc32(item.nodeid.encode()) % sample == 0]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test without the packages and programs that it needs."""
    skip_without([name for mark in item.iter_markers("needs") for name in mark.args])


def pytest_sessionstart(session: pytest.Session) -> None:
    """Build the library, and the image of a board that is asked for, once before the workers begin."""
    if getattr(session.config.option, "numprocesses", None):
        from edmctl.errors import PreconditionError
        from edmctl.simulator import BenchConfig, open_bench

        controller = session.config.getoption("--controller", default="firmware")
        try:
            open_bench(BenchConfig(controller=controller), 0)
        except PreconditionError as error:
            pytest.exit(f"{error.message} {error.hint}", returncode=pytest.ExitCode.USAGE_ERROR)


@pytest.fixture
def here(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> Here:
    """Run command lines in this process and in an empty folder."""
    for name in (
        "EDMCTL_PROFILE",
        "EDMCTL_PORT",
        "EDMCTL_SETUP",
        "EDMCTL_CALIBRATION",
        "NO_COLOR",
        "FORCE_COLOR",
    ):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("EDMCTL_HOME", str(tmp_path_factory.mktemp("home")))
    monkeypatch.chdir(tmp_path_factory.mktemp("work"))
    return Here(capsys)
