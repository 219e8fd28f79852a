"""`edmctl` in a process that has loaded everything: a copy of one process instead of a start for every command.

`python -m tests.cli.warm_process SOCKET` loads the program, makes one small job so that modules and the library are
in memory, and then makes a copy of itself (fork) for each command it is asked for. `client(SOCKET)` is the text of a
program that stands for `edmctl`: it hands over its arguments, folder, environment and streams, passes signals on,
and ends with the exit code of the copy. How a process starts is tested elsewhere (tests/cli/test_start_up.py).
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

MOST = 1 << 20
"""Bytes of a request: arguments and environment."""

WARMING = (
    "machine --profile cu270 --set target.depth_um=8 --seed 1 --run-id warm --quiet",
    "run plot runs/warm.h5",
    "simulate actuator sine --seed 1 --quiet",
    "calibrate --seed 1 --output actuator.toml --quiet",
)
"""Commands that load what others need too."""

_CLIENT = """#!{python} -SE
import array, json, os, signal, socket, sys
line = socket.socket(socket.AF_UNIX)
line.connect({path!r})
request = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ), os.getpgid(0)]).encode()
streams = array.array("i", [0, 1, 2])
line.sendmsg([len(request).to_bytes(4, "big")], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, streams)])
line.sendall(request)
answers = line.makefile()
worker = int(answers.readline())
for number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, lambda number, _: os.kill(worker, number))
signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to the copy too
code = int(answers.readline())
if code < 0:
    signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
sys.exit(code)
"""


def client(path: str) -> str:
    """Return the text of the program that asks the process at this socket."""
    return _CLIENT.format(python=sys.executable, path=path)


@contextmanager
def warm_process(env: dict[str, str]) -> Iterator[str]:
    """Start the process; what comes back is its socket. It and its copies end with the block."""
    with TemporaryDirectory() as folder:
        path = str(Path(folder, "edmctl"))
        command = [sys.executable, "-m", "tests.cli.warm_process", path]
        with subprocess.Popen(command, env=env, cwd=folder, stdout=subprocess.PIPE) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == b"ready\n"
                yield path
            finally:
                process.terminate()


def _main(path: str) -> None:
    """Load, listen, copy."""
    import matplotlib.figure  # noqa: F401  what a figure needs

    import edmctl.__main__ as entry
    from edmctl.app import main
    from edmctl.start_up import spare_start_up

    spare_start_up()
    with TemporaryDirectory() as folder, Path(os.devnull).open("w") as nowhere:
        os.environ["EDMCTL_HOME"] = folder
        os.chdir(folder)
        sys.stdout, kept = nowhere, sys.stdout
        for words in WARMING:
            assert main(words.split()) == 0, words
        sys.stdout = kept
    assert threading.active_count() == 1, threading.enumerate()
    sys.modules["__main__"] = entry  # workers of a command begin with the program, not with this
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for those that serve
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(path)
        listening.listen(16)
        print("ready", flush=True)
        while True:
            asked, _ = listening.accept()
            with asked:
                if os.fork() == 0:
                    listening.close()
                    _serve(asked, entry)


def _serve(line: socket.socket, entry: object) -> None:
    """Make a copy for one command, and tell its number and in the end its exit code."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    head, streams, _, _ = socket.recv_fds(line, 4, 3)
    request, size = b"", int.from_bytes(head, "big")
    while len(request) < size:
        request += line.recv(min(MOST, size - len(request)))
    arguments, folder, env, group = json.loads(request)
    worker = os.fork()
    if worker == 0:
        line.close()
        os.setpgid(0, group)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(env)
        sys.argv = ["edmctl", *arguments]
        for name, number, mode in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
            opened = open(number, mode, encoding="utf-8", closefd=False)  # noqa: SIM115  as Python starts
            setattr(sys, name, opened)
            setattr(sys, f"__{name}__", opened)
        os._exit(_exit_code(entry))
    for stream in streams:
        os.close(stream)
    line.sendall(f"{worker}\n".encode())
    _, status = os.waitpid(worker, 0)
    try:
        line.sendall(f"{os.waitstatus_to_exitcode(status)}\n".encode())
    finally:
        os._exit(0)


def _exit_code(entry: object) -> int:
    """Run the command as a new process would."""
    import traceback

    code: object = 0
    try:
        entry.main()  # type: ignore[attr-defined]
    except SystemExit as left:
        code = left.code
    except BaseException:
        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            code = code or 120
    return code if isinstance(code, int) else int(code is not None)


if __name__ == "__main__":
    _main(sys.argv[1])
