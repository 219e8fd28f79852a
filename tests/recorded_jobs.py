"""The `--json` output of 65 jobs: all commands, five seeds, as it was recorded.

    python -m tests.recorded_jobs --record
    python -m tests.recorded_jobs --check

--check compares byte for byte and prints the first difference of each job. Times of day, run times of the computer,
sizes of files (HDF5 decides) and folders are replaced before. The last digits of whole jobs depend on the processor
(CONTRIBUTING.md, Results), so the test of this recording, tests/test_recorded_jobs.py, allows a relative difference
of 1e-9.
"""

from __future__ import annotations

import contextlib
import difflib
import gzip
import io
import json
import os
import re
import sys
import tempfile
from pathlib import Path

from edmctl.app import main as edmctl

RECORDING = Path(__file__).with_name("recorded_jobs.json.gz")
SEEDS = (1, 2, 3, 4, 5)
_SMALL = ("--profile", "cu270", "--set", "target.depth_um=12")
_CHANGING = (
    (re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(\+\d\d:\d\d|Z)?"), "TIME"),
    (re.compile(r"\d{8}T\d{6}Z?|\d{8}-\d{6}"), "TIME"),
    (re.compile(r'"(elapsed_s|wall_s|cpu_s|took_s|host|user|pid|version|git)": [^,\n}]+'), r'"\1": 0'),
    (re.compile(r'"(size_bytes)": \d+'), r'"\1": 0'),
)


def _scenario(seed: int) -> dict[str, tuple[str, ...]]:
    """Commands in one folder, one after the other, by name."""
    seeded, kept = ("--seed", str(seed)), ("--port", "sim:bench", "--seed", str(seed))
    return {
        "machine": ("machine", *_SMALL, *seeded, "--run-id", "one"),
        "array": (
            "machine",
            "--profile",
            "array-3x3",
            "--set",
            "target.depth_um=10",
            *seeded,
            "--run-id",
            "array",
        ),
        "kept": ("machine", *_SMALL, *kept, "--run-id", "kept"),
        "measure-wear": ("measure-wear", *_SMALL, *kept, "--run-id", "wear"),
        "calibrate": ("calibrate", *seeded, "--output", "calibration.json"),
        "approach": ("approach", *_SMALL, *seeded, "--run-id", "approach"),
        "jump-flush": ("jump-flush", *_SMALL, *seeded, "--run-id", "jumps"),
        "measure-drift": ("measure-drift", *_SMALL, *seeded, "--run-id", "drift", "--duration", "800"),
        "simulate": ("simulate", *_SMALL, *seeded, "-n", "2"),
        "simulate actuator": ("simulate", "actuator", "sine", *seeded),
        "run show": ("run", "show", "runs/one.h5"),
        "run compare": ("run", "compare", "runs/one.h5", "runs/kept.h5"),
    }


WITHOUT_SEED = {
    "profile show": ("profile", "show", "cu270"),
    "profile list": ("profile", "list"),
    "study plan": ("study", "plan", "taguchi-l9"),
    "study run": ("study", "run", "taguchi-l9", "--out", "study"),
    "study report": ("study", "report", "study"),
}


def _said(arguments: tuple[str, ...]) -> str:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = edmctl((*arguments, "--json"))
    return f"exit {code}\n{out.getvalue()}" if out.getvalue() else f"exit {code}\n{err.getvalue()}"


def jobs(seed: int | None) -> dict[str, str]:
    """Run the scenario of a seed in the current folder, which is empty; return what each command printed."""
    os.environ["EDMCTL_HOME"] = str(Path("home").absolute())
    here, root = str(Path.cwd()), str(Path(__file__).parents[1])
    printed = {}
    for name, arguments in (WITHOUT_SEED if seed is None else _scenario(seed)).items():
        text = _said(arguments).replace(here, "HERE").replace(root, "ROOT")
        for pattern, with_what in _CHANGING:
            text = pattern.sub(with_what, text)
        printed[name if seed is None else f"{name} {seed}"] = text
    return printed


def recorded() -> dict[str, str]:
    """Return the recording."""
    found: dict[str, str] = json.loads(gzip.decompress(RECORDING.read_bytes()))
    return found


def _all() -> dict[str, str]:
    everything: dict[str, str] = {}
    for seed in (*SEEDS, None):
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            everything |= jobs(seed)
    return everything


def main(arguments: list[str]) -> int:
    """Record or check; return the exit code."""
    if arguments not in (["--record"], ["--check"]):
        sys.stderr.write("usage: python -m tests.recorded_jobs --record|--check\n")
        return 2
    sys.argv = ["edmctl"]  # run files contain it
    now = _all()
    if arguments == ["--record"]:
        RECORDING.write_bytes(gzip.compress(json.dumps(now, indent=0).encode(), mtime=0))
        return 0
    before, differing = recorded(), 0
    for name in before.keys() | now.keys():
        old, new = before.get(name, ""), now.get(name, "")
        if old != new:
            differing += 1
            lines = difflib.unified_diff(
                old.replace(",", ",\n").splitlines(), new.replace(",", ",\n").splitlines(), lineterm="", n=1
            )
            sys.stdout.write(f"{name} differs:\n" + "\n".join(list(lines)[:12]) + "\n")
    sys.stdout.write(f"{len(before) - differing} of {len(before)} jobs as recorded\n")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
