"""Put deliberate faults into the firmware's core, one at a time in a copy, and see whether a comparison finds each.

    python benchmarks/firmware_faults.py [--schedules 80] [--steps 300] [--only NAME]

Each has to change the digest of a random schedule (tests/firmware/schedules.py). Ends with 1 where one does not.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.common import options
from edmctl.core import build
from edmctl.core.library import loaded
from tests.firmware.schedules import Schedule

FAULTS = {
    "sign of the ramp": (
        "motion.c",
        "sloped(c, is_up ? m->ramp_v_s : -m->ramp_v_s)",
        "sloped(c, m->ramp_v_s)",
    ),
    "fault not latched": ("states.c", "    latch(c, code); /*", "    /*"),
    "window of seq off by one": ("delivery.c", "ahead < HALF", "ahead <= HALF"),
    "watchdog fed by copies": (
        "delivery.c",
        "    if (before != NULL) {\n",
        "    if (before != NULL) {\n        watchdog_feed(c);\n",
    ),
    "heartbeats not compared": (
        "delivery.c",
        "beat_us > link->newest_beat_us",
        "beat_us >= link->newest_beat_us",
    ),
    "watchdog one tick late": ("watchdog.c", "c->tick >= watchdog_tick(c)", "c->tick > watchdog_tick(c)"),
    "seventh zero aborts": ("frame.c", "r->zeros == ABORT_ZEROS - 1", "r->zeros == ABORT_ZEROS - 2"),
    "oldest event acknowledged alone": (
        "events.c",
        "uint8_t rest = (uint8_t)(events->count - i - 1);",
        "uint8_t rest = (uint8_t)(events->count - 1);",
    ),
    "hysteresis of the relay not halved": (
        "servo.c",
        "error < R(-0.5) * s->hysteresis",
        "error < -s->hysteresis",
    ),
    "short not hurried": ("servo.c", "? R(4.0) : R(1.0)", "? R(1.0) : R(1.0)"),
    "arc judged without its delay": ("pulses.c", " && !(c->readings.delay_us[i] >= s->arc_delay_us)", ""),
    "pulses flow on after TIME_UP": (
        "motion.c",
        "    motion_gate(c, false);\n    c->scan.scanning = false;\n    c->scan.count = 0;\n",
        "    c->scan.scanning = false;\n    c->scan.count = 0;\n",
    ),
    "former nonce opens again": ("session.c", "if (is_used(c, request.host_nonce))", "if (false)"),
    "touch before the flip": (
        "touch.c",
        "c->motion.phase < c->motion.dwell_ticks",
        "c->motion.phase <= c->motion.dwell_ticks",
    ),
    "stage path ignores shorts": ("scan.c", "c->gap.shorted || ", ""),
    "parameters survive a reset": (
        "states.c",
        "    session_begin(c, 0);\n    parameters_reset(c);\n",
        "    session_begin(c, 0);\n",
    ),
    "sample of the state that follows": (
        "telemetry.c",
        "        .state = c->state,",
        "        .state = c->motion.mode == HOLD ? STATE_ARMED : c->state,",
    ),
    "interlock bit of the door": (
        "guards.c",
        "inputs->door_open ? INTERLOCKS_DOOR : 0",
        "inputs->door_open ? INTERLOCKS_HV_SUPPLY : 0",
    ),
}


def digest(seed: int, steps: int) -> tuple[str, int]:
    """Return what comes of a schedule, and how many commands it has."""
    schedule = Schedule(seed)
    try:
        schedule.run(steps)
    except RuntimeError as error:  # frames that do not fit into the memory of the line
        return str(error), schedule.commands
    return schedule.digest(), schedule.commands


def found_by(name: str, expected: list[str], steps: int) -> str:
    """Return in which schedule and within how many commands a fault was found; empty where it was not.

    expected : digests of the schedules 1, 2, ... without a fault.
    """
    file, right, wrong = FAULTS[name]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "firmware"
        shutil.copytree(build.source_folder(), copy)
        path = copy / "core" / file
        source = path.read_text(encoding="utf-8")
        if source.count(right) != 1:
            raise SystemExit(f"{name}: its place in {file} is gone")
        path.write_text(source.replace(right, wrong), encoding="utf-8")
        with (
            mock.patch.object(build, "source_folder", return_value=copy),
            mock.patch.dict("os.environ", {build.CACHE_VARIABLE: folder}),
        ):
            loaded.cache_clear()
            commands = 0
            for seed, sound in enumerate(expected, 1):
                found, sent = digest(seed, steps)
                commands += sent
                if found != sound:
                    return f"schedule {seed}, within {commands} commands"
    return ""


def main() -> int:
    """Try every fault; 1 where one was not found."""
    given = options(__doc__, {"only": FAULTS}, schedules=80, steps=300, only=None)
    expected = [digest(seed, given.steps)[0] for seed in range(1, given.schedules + 1)]
    missed = 0
    for name in [given.only] if given.only else FAULTS:
        where = found_by(name, expected, given.steps)
        print(f"{name}: {where or 'NOT FOUND'}", flush=True)
        missed += not where
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
