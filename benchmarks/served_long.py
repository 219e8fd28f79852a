"""What a served bench holds over many commands: `python -m benchmarks.served_long [--commands 200]`.

Short commands one after the other against `edmctl simulate serve`, on a pty and on a socket, as fast as both can.
After each, memory, open file descriptors and threads of the server are read. Exit code 1 where a command fails, or
the server has more descriptors or threads in the last quarter of the commands than in the one before.
"""

from __future__ import annotations

import argparse
import socket
import sys
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path

from benchmarks.holding import Held, held_by, second_half
from benchmarks.serving import READY_S, server, start

PROFILE = ("-p", "cu270")
COMMANDS = (
    ("doctor",),
    ("approach", *PROFILE, "--quiet"),
    ("jump-flush", *PROFILE, "--quiet"),
    ("reset",),
)


def after_each(home: Path, commands: int, port: str, *options: str) -> list[Held]:
    """What the server holds after each command. Raises RuntimeError where one fails."""
    held: list[Held] = []
    with server(home, *PROFILE, "--seed", "1", "--speed", "max", *options) as process:
        for command in islice(cycle(COMMANDS), commands):
            client = start(home, *command, "--port", port, "--wait", f"{READY_S:g}")
            _, err = client.communicate()
            now = held_by(process.pid)
            if client.returncode != 0 or now is None:
                raise RuntimeError(f"{' '.join(command)}: exit {client.returncode}\n{err}")
            held.append(now)
    return held


def free_port() -> int:
    """A port of this computer that nobody serves."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        number: int = listener.getsockname()[1]
    return number


def met(name: str, held: list[Held], wall_s: float) -> bool:
    """Print the figures of a server; whether it met the bar."""
    descriptors = second_half([now.descriptors for now in held])
    threads = second_half([now.threads for now in held])
    print(
        f"{name:6} {len(held)} commands in {wall_s:.0f} s; {held[0].rss_mb:.0f} MB after the first, "
        f"{held[len(held) // 2].rss_mb:.0f} MB half-way, {held[-1].rss_mb:.0f} MB after the last\n"
        f"       in the second half: descriptors {descriptors}; threads {threads} (bar: no growth)",
        flush=True,
    )
    return descriptors.growth <= 0 and threads.growth <= 0


def main() -> int:
    """Serve both ways, print, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--commands", type=int, default=200)
    arguments = parser.parse_args()
    address = f"127.0.0.1:{free_port()}"
    well = True
    for name, port, option in (
        ("pty", "./edm", "--link=edm"),
        ("socket", f"socket://{address}", f"--socket={address}"),
    ):
        with tempfile.TemporaryDirectory() as folder:
            begin_s = time.monotonic()
            held = after_each(Path(folder), arguments.commands, port, option)
        well = met(name, held, time.monotonic() - begin_s) and well
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
