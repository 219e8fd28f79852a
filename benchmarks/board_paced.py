"""Run the conformance suite against the emulated board behind a pseudo-terminal, at the pace of clock and line.

    python benchmarks/board_paced.py [PYTEST ARGUMENTS]

What a suite that drives the clock itself cannot show: bytes that take their time, a host that sleeps. Tests that
need sparks or injected faults are skipped, each with its reason: the suite has no hand on a machine behind a port.
Prints what pytest says, with the reasons counted, and ends with its exit code.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
BAUD = "921600"
START_S = 180.0  # the first start compiles the models


def main(arguments: list[str]) -> int:
    """Serve the board, run the suite, end the board."""
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "told").open("w+") as told:
        port = Path(folder) / "board"
        serve = ["simulate", "serve", "--controller", "stm32", "--baud", BAUD, "--link", str(port)]
        board = subprocess.Popen([sys.executable, "-m", "edmctl", *serve], cwd=ROOT, stdout=told, stderr=told)
        try:
            until_s = time.monotonic() + START_S
            while not port.exists():
                if board.poll() is not None or time.monotonic() > until_s:
                    told.seek(0)
                    print(f"The board has not come up:\n{told.read()}", file=sys.stderr)
                    return 1
                time.sleep(0.1)
            suite = ["tests/conformance", "--controller-port", str(port), "--controller-baud", BAUD]
            command = [sys.executable, "-m", "pytest", "-n", "0", "-rs", *suite, *arguments]
            return subprocess.run(command, cwd=ROOT, check=False).returncode
        finally:
            board.send_signal(signal.SIGINT)
            board.wait()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
