"""Settings of all tests."""

from __future__ import annotations

import os
import signal
import sys
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from hypothesis import settings

from edmctl.cli.start_up import spare_start_up

if TYPE_CHECKING:
    import pytest

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
    """Where no bytecode is to be written, keep it beside the tree while they run: each process compiled it all."""
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None) is None or hasattr(config, "workerinput"):
        return
    folder = TemporaryDirectory(prefix="edmctl-bytecode-")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = folder.name
    sys.dont_write_bytecode = False
    config.add_cleanup(folder.cleanup)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile once before the workers begin, who would all do it otherwise, and the servers that they wait for."""
    if getattr(session.config.option, "numprocesses", None):
        from edmctl.simulator import BenchConfig, open_bench

        open_bench(BenchConfig(), 0).warm_up()
