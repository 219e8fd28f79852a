"""CPU time of the tests by file and tier: `python tools/durations.py [--write | --check] [PYTEST ARGUMENTS]`.

Runs every tier, or what the arguments select, and prints the table and the most expensive tests; `--write` stores
the measured rows in `tests/durations.md`. `--check` runs the default tier and fails where a test itself, without its
fixtures, costs more than a quarter of the reference job, and no marker `expensive("REASON")` says why.
CPU time includes the processes that a test starts; unlike wall time it hardly depends on what else the machine does.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import pytest

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "tests" / "durations.md"
TIERS = ("default", "slow", "full")
MOST_EXPENSIVE = 40
PLUGIN = "tools.durations"
"""This module by the name under which workers load it."""
REFERENCE_JOB = ("machine", "--profile", "cu270", "--seed", "2", "--quiet")
PRICE = 0.25
"""Most that a test of the default tier may cost, in reference jobs."""


class Cost(NamedTuple):
    """CPU time of a test, s: with its fixtures, and of the test itself."""

    tier: str
    total_s: float
    call_s: float
    is_exempt: bool


Cell = tuple[int, float]
"""Number of tests, and their seconds."""
_begin_s = 0.0
_call_s = 0.0
_costs: dict[str, Cost] = {}


def cpu_s() -> float:
    """CPU time of this process and of the children it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def tier_of(item: pytest.Item) -> str:
    """The tier that a test is in: the rarest that a marker names."""
    return next((tier for tier in reversed(TIERS) if item.get_closest_marker(tier)), TIERS[0])


def pytest_runtest_logstart() -> None:
    """Begin to count."""
    global _begin_s
    _begin_s = cpu_s()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, None, None]:
    """Count the test itself."""
    global _call_s
    begin_s = cpu_s()
    try:
        yield
    finally:
        _call_s = cpu_s() - begin_s


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Send what was counted with the last report of a test."""
    global _call_s
    report = yield
    if call.when == "teardown":
        exempt = item.get_closest_marker("expensive") is not None
        report.user_properties.append(("cost", (tier_of(item), cpu_s() - _begin_s, _call_s, exempt)))
        _call_s = 0.0
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep what arrives, from this process or from a worker."""
    for name, cost in report.user_properties:
        if name == "cost":
            _costs[report.nodeid] = Cost(*cost)  # type: ignore[misc]


def rows_of(costs: dict[str, Cost]) -> dict[tuple[str, str], Cell]:
    """Number of tests and seconds by file and tier."""
    rows: dict[tuple[str, str], Cell] = {}
    for test, cost in costs.items():
        key = (test.partition("::")[0], cost.tier)
        number, sum_s = rows.get(key, (0, 0.0))
        rows[key] = (number + 1, sum_s + cost.total_s)
    return rows


def rows_written(text: str) -> dict[tuple[str, str], Cell]:
    """The same of a table that was made before."""
    rows: dict[tuple[str, str], Cell] = {}
    for line in text.splitlines():
        file, *cells = (word.strip() for word in line.strip("| ").split("|"))
        if file.endswith(".py") and len(cells) == 2 * len(TIERS):
            for i, tier in enumerate(TIERS):
                if cells[2 * i] != "-":
                    rows[file, tier] = (int(cells[2 * i]), float(cells[2 * i + 1]))
    return rows


def table(rows: dict[tuple[str, str], Cell]) -> str:
    """The table of the files, the most expensive first."""

    def sums(files: set[str], tier: str) -> Cell:
        cells = [cell for (file, its), cell in rows.items() if its == tier and file in files]
        return sum(number for number, _ in cells), sum(time_s for _, time_s in cells)

    def line(name: str, files: set[str]) -> str:
        cells = [sums(files, tier) for tier in TIERS]
        return f"| {name} | " + " | ".join(f"{n} | {s:.1f}" if n else "- | -" for n, s in cells) + " |"

    files = {file for file, _ in rows}
    ordered = sorted(files, key=lambda file: (-sum(sums({file}, tier)[1] for tier in TIERS), file))
    lines = [
        "# CPU time of the tests",
        "",
        "Made by `python tools/durations.py --write`, "
        f"Python {platform.python_version()} on {platform.machine()}. Seconds of CPU: divided by the number of",
        "cores they are about the time on the wall of an idle machine; a busy one makes them more.",
        "",
        "| file | " + " | ".join(f"{tier}: tests | s" for tier in TIERS) + " |",
        "|---|" + "--:|--:|" * len(TIERS),
        line("all", files),
        *(line(file, {file}) for file in ordered),
    ]
    return "\n".join(lines) + "\n"


def listed(costs: Iterable[tuple[str, Cost]]) -> str:
    """Tests with what they cost, a line each, the most expensive first."""
    ordered = sorted(costs, key=lambda item: -item[1].call_s)
    return "\n".join(
        f"{cost.call_s:6.2f} s ({cost.total_s:.2f} s with fixtures)  {cost.tier:8}{test}"
        for test, cost in ordered
    )


def reference_s() -> float:
    """CPU time of the reference job, once everything it loads has been compiled."""
    command = [sys.executable, "-m", "edmctl", *REFERENCE_JOB]
    with TemporaryDirectory() as folder:
        env = {**os.environ, "EDMCTL_HOME": folder}
        for run in ("first", "second"):
            begin_s = cpu_s()
            subprocess.run([*command, "--out", f"{folder}/{run}"], env=env, check=True, capture_output=True)
    return cpu_s() - begin_s


def check(costs: dict[str, Cost], most_s: float) -> int:
    """Print the tests of the default tier that cost more than that; the exit code."""
    dear = {test: cost for test, cost in costs.items() if cost.call_s > most_s and not cost.is_exempt}
    print(f"{len(dear)} tests cost more than {most_s:.2f} s, a quarter of the reference job")
    print(listed(dear.items()))
    return int(bool(dear))


def main(arguments: list[str]) -> int:
    """Run the tests and print, write or check what they cost; the exit code is that of pytest or of the check."""
    options = [word for word in arguments if word not in ("--write", "--check")]
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    most_s = PRICE * reference_s() if "--check" in arguments else 0.0
    tier = [] if "--check" in arguments else ["-m", ""]
    exit_code = int(pytest.main(["-p", PLUGIN, "-n", "auto", "--dist", "worksteal", *tier, *options]))
    costs: dict[str, Cost] = sys.modules[PLUGIN]._costs
    if "--check" in arguments:
        return exit_code or check(costs, most_s)
    rows = rows_of(costs)
    print(listed(sorted(costs.items(), key=lambda item: -item[1].call_s)[:MOST_EXPENSIVE]))
    if "--write" in arguments:
        kept = rows_written(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else {}
        rows = {key: cell for key, cell in (kept | rows).items() if (ROOT / key[0]).exists()}
        TABLE.write_text(table(rows), encoding="utf-8")
    else:
        print(table(rows))
    return exit_code


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
