"""Break the program in 40 ways and see whether the tests notice: `python benchmarks/mutation_check.py [NAME…]`.

Each mutation changes one expression or statement of servo, session, record or decision code in a temporary copy.
The test files that should see it run first, and where they pass the whole default tier does, but with `--targeted`.
One that survives means that a behaviour is not tested. `--check` only looks whether every place is still there,
`--jobs 2` works on two at a time. Ends with 1 where a mutation survives or its place is gone.
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).parents[1]
PACKAGE = "edmctl"
TARGETED_S, ALL_S = 400.0, 900.0
"""A program that hangs is noticed, too: so long its tests may take, those of one file and all."""


@dataclass(frozen=True, slots=True)
class Mutation:
    """In the function `where` (`f` or `Class.f` of any file) `old` becomes `new`; `tests` should see it.

    In a file of firmware/core (`where` ends with .c) `old` is text.
    """

    name: str
    where: str
    old: str
    new: str
    tests: str


SERVO = (
    Mutation(
        "a short drives the tool on",
        "servo.c",
        "-hurry * s->short_back_um_s * s->v_per_um",
        "hurry * s->short_back_um_s * s->v_per_um",
        "simulator/test_servo.py",
    ),
    Mutation(
        "a short that lasts is left no faster",
        "servo.c",
        "c->gap.short_ticks > SHORT_HURRY_TICKS ? R(4.0) : R(1.0)",
        "R(1.0)",
        "simulator/test_servo.py",
    ),
    Mutation(
        "the servo has no latency",
        "servo.c",
        "(count > latency ? count - latency : 0) % HISTORY",
        "count % HISTORY",
        "simulator/test_servo.py",
    ),
    Mutation(
        "silent ticks do not count for the mean gap voltage",
        "gap.c",
        "power_of(R(1.0) - s->filter_alpha, elapsed)",
        "power_of(R(1.0) - s->filter_alpha, 1)",
        "simulator/test_servo.py",
    ),
    Mutation(
        "a stuck short is borne twice as long",
        "gap.c",
        "gap->short_ticks > s->short_ticks_max",
        "gap->short_ticks > 2 * s->short_ticks_max",
        "simulator/test_faults.py conformance/test_safety.py",
    ),
    Mutation(
        "an arc may burn one pulse longer",
        "gap.c",
        "gap->arc_run >= s->arc_run_max",
        "gap->arc_run > s->arc_run_max",
        "simulator/test_faults.py conformance/test_safety.py",
    ),
    Mutation(
        "a cut ends 2 µm beyond its limit",
        "servo.c",
        "return c->gap.slow_displacement_um >= c->servo.z_limit_um;",
        "return c->gap.slow_displacement_um >= c->servo.z_limit_um + 2;",
        "simulator/test_controller.py simulator/test_servo.py",
    ),
    Mutation(
        "the way out has no slew limit",
        "motion.c",
        "v = least(before + step, most(before - step, v));",
        "v = most(before - step, v);",
        "simulator/test_controller.py",
    ),
    Mutation(
        "a contact under voltage is believed",
        "touch.c",
        "contact && c->gap.tick_gap_v > c->settings.short_v",
        "false",
        "simulator/test_services.py",
    ),
    Mutation(
        "only an actuator that lags is a tracking fault",
        "guards.c",
        "magnitude(c->drive.actuator_v - monitor_v) > s->track_v",
        "c->drive.actuator_v - monitor_v > s->track_v",
        "simulator/test_services.py",
    ),
    Mutation(
        "the stages go on in a short",
        "scan.c",
        "c->gap.shorted || ",
        "",
        "simulator/test_scan.py",
    ),
    Mutation(
        "the watchdog waits twice as long",
        "watchdog.c",
        "c->heard_tick + host_ticks(c, c->settings.watchdog_ticks)",
        "c->heard_tick + 2 * host_ticks(c, c->settings.watchdog_ticks)",
        "conformance/test_safety.py",
    ),
    Mutation(
        "the newest fault is the latched one",
        "states.c",
        "latched != 0 && (code != FAULT_ESTOP || latched == FAULT_ESTOP)",
        "false",
        "conformance/test_safety.py simulator/test_faults.py",
    ),
)

SESSION = (
    Mutation(
        "a new session inherits the sparks",
        "session.c",
        "c->armed && !c->disarming",
        "false",
        "conformance/test_sessions.py conformance/test_safety.py",
    ),
    Mutation(
        "a command is executed as often as it is sent",
        "delivery.c",
        "if (before != NULL) {",
        "if (false) {",
        "conformance/test_delivery.py",
    ),
    Mutation(
        "a repeated heartbeat feeds the watchdog",
        "delivery.c",
        "beat_us > link->newest_beat_us",
        "beat_us >= link->newest_beat_us",
        "conformance/test_delivery.py conformance/test_safety.py",
    ),
    Mutation(
        "a late HELLO opens what it opened before",
        "session.c",
        "is_used(c, request.host_nonce)",
        "false",
        "conformance/test_sessions.py",
    ),
    Mutation(
        "the wait for a reply doubles without end",
        "Session._exchange",
        "min(LONGEST_S, 2.0 * wait_s)",
        "2.0 * wait_s",
        "link/test_session.py",
    ),
    Mutation(
        "the round trip of a repeated command counts",
        "Session._exchange",
        "not repeated",
        "True",
        "link/test_session.py",
    ),
    Mutation(
        "a silent controller is believed four times as long",
        "Session._is_silent",
        "self.transport.now_s() - self._unanswered_since_s > SILENCE_S",
        "self.transport.now_s() - self._unanswered_since_s > 4.0 * SILENCE_S",
        "link/test_session.py",
    ),
    Mutation(
        "a host that hangs goes on beating",
        "HeartbeatThread._run",
        "self._idle_s() < HUNG_S",
        "True",
        "link/test_heartbeat.py",
    ),
    Mutation(
        "an overtaken heartbeat turns the clock back",
        "Session._on_heartbeat",
        "is_ours and before is not None and reply.t_host_us < before.t_host_us",
        "False",
        "link/test_session.py link/test_clock.py",
    ),
    Mutation(
        "a lost controller is kept alive",
        "Session._lose",
        "self._end_heartbeats()",
        "None",
        "link/test_session.py link/test_heartbeat.py link/test_serial_line.py",
    ),
    Mutation(
        "frames of another session are taken",
        "Receiver._dispatch",
        "frame.session != self._session",
        "False",
        "link/test_session.py",
    ),
)

RECORD = (
    Mutation(
        "the state of a cut is kept ten times as seldom",
        "JournalFile.keep",
        "state.time_s - self._kept_s < PERIOD_S",
        "state.time_s - self._kept_s < 10.0 * PERIOD_S",
        "record/test_journal.py",
    ),
    Mutation(
        "a journal whose content was changed is believed",
        "read_journal",
        'envelope["sha256"] != _hash_of(_canonical(content))',
        "False",
        "record/test_journal.py",
    ),
    Mutation(
        "a torn line of the ledger stays",
        "_complete_last_line",
        "os.ftruncate(descriptor, size - len(last))",
        "None",
        "record/test_logbook.py",
    ),
    Mutation(
        "warnings wait for the next flush",
        "is_urgent",
        "row.level >= EventLevel.WARNING",
        "row.level > EventLevel.WARNING",
        "record/test_writing.py",
    ),
    Mutation(
        "the wear of the tool is that of the last site",
        "RunWriter.append",
        "self._wear_um += row.wear_um",
        "self._wear_um = row.wear_um",
        "record/test_writing.py",
    ),
    Mutation(
        "a check sum that does not fit is no damage",
        "verify_checksum",
        "_crc32(file, length) == int(seal[2], 16)",
        "True",
        "record/test_recovery.py",
    ),
    Mutation(
        "the ledger mixes the machines",
        "history_of",
        "line.serial != serial",
        "False",
        "record/test_logbook.py",
    ),
    Mutation(
        "the wear of a hole that was taken up counts twice",
        "_take_site",
        "account.lost_before_um -= math.fsum(_known(hole.wear_um) for hole in earlier if hole not in account.since)",
        "pass",
        "record/test_logbook.py cli/test_resume.py",
    ),
)

DECISION = (
    Mutation(
        "a hole is done at its tolerance",
        "is_done",
        "tolerance_um / 2.0",
        "tolerance_um",
        "process/test_next_cut.py",
    ),
    Mutation(
        "a cut goes to the target on half the certainty",
        "next_cut",
        "CLEAR_SIGMAS * whole.depth_u_um <= tolerance_um",
        "whole.depth_u_um <= tolerance_um",
        "process/test_next_cut.py",
    ),
    Mutation(
        "a depth is shown however wide its interval",
        "verdict_of",
        "depth_u95_um <= target.tolerance_um",
        "True",
        "procedures/test_verdict.py",
    ),
    Mutation(
        "cuts that were broken off use up the budget",
        "decide",
        "cut_budget(profile) + broken_cuts",
        "cut_budget(profile)",
        "cli/test_resume.py",
    ),
    Mutation(
        "arcs that stay end no cut",
        "RatioLimits._look",
        "now_s - since_s > UNSTABLE_S",
        "False",
        "procedures/test_supervisor.py",
    ),
    Mutation(
        "a cut that stands asks for one jump after the other",
        "StallDetection.update",
        "stood_s > JUMP_AFTER_S and not self._tried",
        "stood_s > JUMP_AFTER_S",
        "procedures/test_supervisor.py",
    ),
    Mutation(
        "a shallow cut may not go beyond its target",
        "Supervisor._look_for_the_end",
        "max(LEAST_OVERRUN_UM, OVERRUN_SHARE * wanted_um)",
        "min(LEAST_OVERRUN_UM, OVERRUN_SHARE * wanted_um)",
        "procedures/test_supervisor.py",
    ),
    Mutation(
        "a third burn ends the cut however late",
        "Cut.recover",
        "self._burns > 2 and is_soon",
        "self._burns > 2",
        "procedures/test_recoveries.py",
    ),
)

MUTATIONS = (*SERVO, *SESSION, *RECORD, *DECISION)


@dataclass(frozen=True, slots=True)
class Place:
    """Where a mutation is in its file: from one byte to another."""

    path: Path
    begin: int
    end: int


class Lost(Exception):
    """A mutation whose place is not there, or not the only one."""


def place_of(mutation: Mutation, root: Path) -> Place:
    """Find the place by the syntax of `old`, however it is laid out. Raises Lost."""
    if mutation.where.endswith(".c"):
        return _place_in_c(mutation, root)
    wanted = _dump(mutation.old)
    name = mutation.where.rpartition(".")[2]
    found = []
    for path in sorted((root / PACKAGE).rglob("*.py")):
        text = path.read_bytes()
        if f"def {name}(".encode() not in text:
            continue
        for function in _functions(ast.parse(text), mutation.where):
            found += [
                _span(path, text, node)
                for node in ast.walk(function)
                if isinstance(node, ast.expr | ast.stmt) and ast.dump(node) == wanted
            ]
    if len(found) != 1:
        raise Lost(f"{mutation.where}: {len(found)} places of `{mutation.old}`")
    return found[0]


def _place_in_c(mutation: Mutation, root: Path) -> Place:
    path, old = root / "firmware" / "core" / mutation.where, mutation.old.encode()
    text = path.read_bytes()
    if text.count(old) != 1:
        raise Lost(f"{mutation.where}: {text.count(old)} places of `{mutation.old}`")
    begin = text.index(old)
    return Place(path, begin, begin + len(old))


def _functions(tree: ast.Module, where: str) -> list[ast.AST]:
    """Definitions of `f`, or of `f` in the class of `Class.f`."""
    owner, _, name = where.rpartition(".")
    scopes: list[ast.AST] = [tree]
    if owner:
        scopes = [n for n in ast.walk(tree) if isinstance(n, ast.ClassDef) and n.name == owner]
    return [
        n for s in scopes for n in getattr(s, "body", ()) if isinstance(n, ast.FunctionDef) and n.name == name
    ]


def _dump(source: str) -> str:
    (statement,) = ast.parse(source).body
    return ast.dump(statement.value if isinstance(statement, ast.Expr) else statement)


def _span(path: Path, text: bytes, node: ast.expr | ast.stmt) -> Place:
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return Place(
        path, starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
    )


class Copies:
    """Copies of the tracked files of a tree, each for one mutation at a time."""

    def __init__(self, root: Path, folder: Path, count: int) -> None:
        self._free: SimpleQueue[Path] = SimpleQueue()
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, check=True, stdout=subprocess.PIPE)
        names = [name for name in listed.stdout.decode().split("\0") if (root / name).is_file()]
        for number in range(count):
            copy = folder / f"copy-{number}"
            for name in names:
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, copy / name)
            self._free.put(copy)

    @contextmanager
    def one(self) -> Iterator[Path]:
        """Give a copy that nothing else uses."""
        copy = self._free.get()
        try:
            yield copy
        finally:
            self._free.put(copy)


@contextmanager
def changed(path: Path, content: bytes) -> Iterator[None]:
    """Replace a file within the block."""
    before, times = path.read_bytes(), path.stat()
    path.write_bytes(content)
    try:
        yield
    finally:
        path.write_bytes(before)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def try_out(mutation: Mutation, copies: Copies, *, whole_tier: bool) -> tuple[Mutation, str, float]:
    """Apply a mutation and run the tests; return how it ended, and how long it took."""
    start_s = time.monotonic()
    with copies.one() as copy:
        place = place_of(mutation, copy)
        before = place.path.read_bytes()
        new = f"({mutation.new})" if _is_expression(mutation) else mutation.new
        with changed(place.path, before[: place.begin] + new.encode() + before[place.end :]):
            fate = _fate(copy, mutation, whole_tier=whole_tier)
    return mutation, fate, time.monotonic() - start_s


def _is_expression(mutation: Mutation) -> bool:
    if mutation.where.endswith(".c"):
        return False
    (statement,) = ast.parse(mutation.new).body
    return isinstance(statement, ast.Expr)


def _fate(copy: Path, mutation: Mutation, *, whole_tier: bool) -> str:
    targeted = [f"tests/{name}" for name in mutation.tests.split()]
    if seen := failing_test(copy, targeted, TARGETED_S):
        return f"caught by {seen}"
    if whole_tier and (seen := failing_test(copy, ["-n", "auto", "--dist", "worksteal"], ALL_S)):
        return f"caught, but not by its files: {seen}"
    return "SURVIVED"


def failing_test(copy: Path, arguments: list[str], most_s: float) -> str:
    """Return the first test that fails; empty if all pass. Raises RuntimeError if they cannot run."""
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-rfE", *arguments]
    with subprocess.Popen(
        command,
        cwd=copy,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        process_group=0,
    ) as tests:
        try:
            out, _ = tests.communicate(timeout=most_s)
        except subprocess.TimeoutExpired:
            os.killpg(tests.pid, signal.SIGKILL)
            tests.communicate()
            return f"tests that do not end in {most_s:.0f} s"
    if tests.returncode == 0:
        return ""
    told = (line.partition(" - ")[0] for line in out.splitlines() if line.startswith(("FAILED ", "ERROR ")))
    failed = [line.partition(" ")[2] for line in told]
    if tests.returncode != 1 or not failed:
        raise RuntimeError(f"pytest {' '.join(arguments)} ended with {tests.returncode}:\n{out[-2000:]}")
    return failed[0].removeprefix("tests/")


def main(arguments: list[str] | None = None) -> int:
    """Try the mutations; the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument(
        "names", nargs="*", help="words in the names of the mutations to try; all without any"
    )
    parser.add_argument("--check", action="store_true", help="only look whether every place is still there")
    parser.add_argument(
        "--targeted", action="store_true", help="run no more than the files that should see it"
    )
    parser.add_argument("--jobs", type=int, default=1, help="mutations at a time")
    chosen = parser.parse_args(arguments)
    mutations = [m for m in MUTATIONS if not chosen.names or any(word in m.name for word in chosen.names)]
    wrong = 0
    for mutation in mutations:
        try:
            place_of(mutation, ROOT)
        except Lost as lost:
            print(f"gone: {mutation.name}: {lost}")
            wrong += 1
        for name in mutation.tests.split():
            if not (ROOT / "tests" / name).exists():
                print(f"gone: {mutation.name}: tests/{name}")
                wrong += 1
    if chosen.check or wrong:
        print(f"{len(mutations)} mutations, {wrong} places gone")
        return int(wrong > 0)
    with (
        tempfile.TemporaryDirectory(prefix="edmctl-mutations.") as folder,
        ThreadPoolExecutor(chosen.jobs) as pool,
    ):
        copies = Copies(ROOT, Path(folder), chosen.jobs)
        attempt = partial(try_out, copies=copies, whole_tier=not chosen.targeted)
        survived = 0
        for mutation, fate, took_s in pool.map(attempt, mutations):
            survived += fate == "SURVIVED"
            print(f"{took_s:5.0f} s  {mutation.name}: {fate}", flush=True)
    print(f"{len(mutations)} mutations, {survived} survived")
    return int(survived > 0)


if __name__ == "__main__":
    sys.exit(main())
