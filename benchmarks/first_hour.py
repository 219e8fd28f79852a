"""The first hour of a new user: `python -m benchmarks.first_hour`.

The first command of the README is typed in a copy of the tracked files, with a cache of its own, and then every
command of README, tutorial and how-to as it stands, in that environment alone. Told are the time of installation,
the time from the first start of `edmctl` to its result, and the longest silence in it.
Exit code 1 where a command did not end as its page says, the first result took over 30 s or was silent for over 5 s.
"""

from __future__ import annotations

import os
import re
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.cli.test_documents import failures_of

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "docs/tutorial.md", "docs/how-to.md")
RESULT_S, SILENCE_S = 30.0, 5.0


def copied(folder: Path) -> Path:
    """Copy the tracked files, as they are."""
    checkout = folder / "edmctl"
    checkout.mkdir()
    files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    packed = ["tar", "--null", "--files-from=-", "-cf", "-"]
    with subprocess.Popen(packed, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as tar:
        unpacking = subprocess.Popen(["tar", "-xf", "-", "-C", str(checkout)], stdin=tar.stdout)
        assert tar.stdin is not None
        tar.stdin.write(files)
        tar.stdin.close()
        unpacking.wait()
    return checkout


def first_command() -> list[str]:
    """The parts of the README's first command: those that install, and the one that machines."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(r"<!-- command: run -->\n```sh\n(.*?)\n```", text, re.DOTALL)
    assert found is not None
    return found[1].split(" && ")


def listened_to(command: str, cwd: Path, env: dict[str, str]) -> tuple[int, float, float]:
    """Exit code of a command, how long it took, and its longest silence."""
    begin_s = heard_s = time.monotonic()
    silence_s = 0.0
    with subprocess.Popen(
        ["bash", "-c", command], cwd=cwd, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as process:
        assert process.stdout is not None
        while select.select([process.stdout], [], [])[0]:
            data = os.read(process.stdout.fileno(), 65536)
            now_s = time.monotonic()
            silence_s, heard_s = max(silence_s, now_s - heard_s), now_s
            if not data:
                break
    return process.returncode, time.monotonic() - begin_s, silence_s


def main() -> int:
    """Walk, print, and return the exit code."""
    with tempfile.TemporaryDirectory() as folder:
        checkout = copied(Path(folder))
        kept = {name: os.environ[name] for name in ("HOME", "LANG", "TMPDIR") if name in os.environ}
        env = {
            **kept,
            "PATH": f"{checkout / '.venv/bin'}{os.pathsep}{os.environ['PATH']}",
            "EDMCTL_HOME": str(Path(folder) / "home"),
        }
        *install, machine = first_command()
        begin_s = time.monotonic()
        for part in install:
            subprocess.run(["bash", "-c", part], cwd=checkout, env=env, check=True)
        print(f"installed in {time.monotonic() - begin_s:.0f} s", flush=True)
        code, took_s, silence_s = listened_to(machine, checkout, env)
        print(
            f"first result after {took_s:.1f} s (bar {RESULT_S:g} s), longest silence {silence_s:.1f} s "
            f"(bar {SILENCE_S:g} s), exit code {code}",
            flush=True,
        )
        wrong = int(code != 0 or took_s > RESULT_S or silence_s > SILENCE_S)
        for page in PAGES:
            empty = Path(folder) / page.replace("/", "-")
            empty.mkdir()
            failures = failures_of(page, empty, env)
            print(f"{page}: {len(failures)} failures", flush=True)
            for failure in failures:
                print(failure)
            wrong += len(failures)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
