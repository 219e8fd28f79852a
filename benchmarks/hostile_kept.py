"""Files that edmctl writes and reads again, replaced by other things: every reader ends soon and with a message.

Run files, benches, ledgers, journals, calibration and drift files, each replaced in ten ways. Every reader runs in a
fork of this process, so that its time is that of reading.
"""

from __future__ import annotations

import copy
import fcntl
import hashlib
import json
import os
import random
import shutil
import signal
import socket
import sys
import time
import tomllib
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import tomli_w

from edmctl.app import main as edmctl
from edmctl.errors import EdmError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

BAR_S, PATIENCE_S = 2.0, 20.0
ATTEMPTS = 3
"""A reader that takes longer than the bar is timed again: other programs may use the computer."""
SPARSE_BYTES = 1 << 40
VARIANTS = 40
"""Of wrong content that a seeded generator makes of a JSON or TOML file."""
RUN, BENCH, LEDGER = "runs/done.h5", "bench.h5", "runs/ledger.jsonl"
JOURNAL, CALIBRATION, DRIFT = "runs/left.journal", "calibration.toml", "drift.toml"

READERS: dict[str, tuple[tuple[str, ...], ...]] = {
    RUN: (
        ("run", "show", RUN),
        ("run", "show", RUN, "--follow"),
        ("run", "list"),
        ("run", "explain", RUN),
        ("run", "plot", RUN, "-o", "figure.svg"),
        ("run", "plot", RUN, "--kind", "report", "-o", "page.html"),
        ("run", "export", RUN, "-t", "servo", "-o", "servo.csv"),
        ("run", "export", RUN, "-o", "tables"),
        ("run", "compare", RUN, "runs/other.h5"),
        ("run", "recover", RUN, "--out", "new.h5"),
        ("calibrate", "--from", RUN),
        ("calibrate", "--from", "runs/other.h5", "--validate", RUN),
        ("machine", "--resume", RUN),
        ("api", "open_run", RUN),
        ("api", "calibrate_files", RUN),
    ),
    BENCH: (
        ("machine", "--profile", "cu270", "--port", f"sim:{BENCH}", "--dry-run"),
        ("approach", "--profile", "cu270", "--port", f"sim:{BENCH}"),
        ("jump-flush", "--profile", "cu270", "--port", f"sim:{BENCH}"),
        ("doctor", "--port", f"sim:{BENCH}"),
        ("reset", "--port", f"sim:{BENCH}", "--ack", "1001"),
        ("simulate", "serve", "--bench", BENCH, "--for", "0"),
        ("machine", "--resume", "left", "--port", f"sim:{BENCH}"),
        ("api", "approach", f"sim:{BENCH}"),
    ),
    LEDGER: (
        ("approach", "--profile", "cu270", "--port", f"sim:{BENCH}"),
        ("measure-wear", "--port", f"sim:{BENCH}"),
        ("measure-wear", "--reference", "--profile", "cu270", "--port", f"sim:{BENCH}"),
        (
            "machine",
            "--profile",
            "cu270",
            "--set",
            "target.depth_um=3",
            "--port",
            f"sim:{BENCH}",
            "--dry-run",
        ),
        ("machine", "--resume", "left", "--dry-run"),
        ("calibrate", "--from", LEDGER),
    ),
    JOURNAL: (
        ("machine", "--resume", "left"),
        ("machine", "--resume", "left", "--dry-run"),
        ("machine", "--resume", JOURNAL, "--dry-run"),
        ("run", "list"),
        ("api", "resume", "left"),
    ),
    CALIBRATION: (
        ("machine", "--profile", "cu270", "--calibration", CALIBRATION, "--dry-run"),
        ("approach", "--profile", "cu270", "--calibration", CALIBRATION),
        ("approach", "--profile", "cu270", "--setup", "named.toml"),
        ("simulate", "actuator", "sine", "--calibration", CALIBRATION),
        ("doctor", "--setup", "named.toml"),
        ("calibrate", "--from", CALIBRATION),
        ("api", "calibration", CALIBRATION),
    ),
    DRIFT: (
        ("machine", "--profile", "cu270", "--setup", "drift-setup.toml", "--dry-run"),
        ("approach", "--profile", "cu270", "--setup", "drift-setup.toml"),
        ("doctor", "--setup", "drift-setup.toml"),
        ("calibrate", "--from", DRIFT),
    ),
}
"""The files and what reads each: arguments of a command, or of a call of the Python API."""
DEEPEST = {
    RUN: (0, 2, 3, 5, 7, 9, 10),
    BENCH: (1, 3),
    LEDGER: (1, 3),
    JOURNAL: (1,),
    CALIBRATION: (1, 3),
    DRIFT: (1,),
}
"""The readers that wrong content meets in most places, by their number."""


@dataclass(slots=True)
class Held:
    """A descriptor that keeps a file locked while a reader tries it."""

    number: int


@dataclass(slots=True)
class Tally:
    """What was tried, and what came of it."""

    readers: int = 0
    tries: int = 0
    hangs: int = 0
    bugs: int = 0
    worst_s: float = 0.0

    def __str__(self) -> str:
        tried = f"{self.readers} readers, {self.tries} tries"
        return f"{tried}: {self.hangs} hangs > {BAR_S:g} s, {self.bugs} E1000, slowest {self.worst_s:.2f} s"


def make_kept(folder: Path) -> None:
    """Make the files that edmctl keeps: an interrupted job on a bench, a run, a calibration, a drift."""
    from tests.cli.left_jobs import MACHINE, at_time_of_cut, stop

    os.chdir(folder)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets its background jobs ignore it
    with Path(os.devnull).open("w") as null, redirect_stdout(null):
        edmctl(
            [
                "machine",
                "--profile",
                "cu270",
                "--set",
                "target.depth_um=3",
                "--run-id",
                "done",
                "--seed",
                "1",
                "--quiet",
                "--out",
                "runs",
            ]
        )
        edmctl(["approach", "--profile", "cu270", "--run-id", "other", "--seed", "1", "--quiet"])
        with at_time_of_cut(2.0, stop):
            edmctl([*MACHINE, "--port", f"sim:{BENCH}", "--run-id", "left", "--quiet"])
        edmctl(["calibrate", "--output", CALIBRATION, "--seed", "1", "--quiet"])
        Path("quick.toml").write_text("[drift]\nhold_s = 30.0\ninterval_s = 25.0\n", encoding="utf-8")
        edmctl(
            [
                "measure-drift",
                "--setup",
                "quick.toml",
                "--output",
                DRIFT,
                "--seed",
                "1",
                "--quiet",
                "--duration",
                "300",
            ]
        )
    Path("named.toml").write_text(f'calibration = "{CALIBRATION}"\n', encoding="utf-8")
    Path("drift-setup.toml").write_text(f'[drift]\nfile = "{DRIFT}"\n', encoding="utf-8")


def replacements(file: str) -> Iterator[tuple[str, Callable[[Path], object], bool]]:
    """Yield kinds, what puts such a one in the place of a file, and whether every reader tries it."""
    yield "pipe", _instead(os.mkfifo), True
    yield "device", _instead(lambda path: path.symlink_to("/dev/zero")), True
    yield "sparse", _sparse, True
    yield "folder", _instead(Path.mkdir), True
    yield "socket", _instead(_socket), True
    yield "loop", _instead(lambda path: path.symlink_to(path.name)), True
    yield "cut", lambda path: os.truncate(path, path.stat().st_size // 2), True
    yield "garbage", lambda path: path.write_bytes(random.Random(1).randbytes(20_000)), True
    yield "locked", _locked, True
    for number, change in enumerate(WRONG[file](file)):
        yield f"wrong {number}", change, number == 0


def _instead(make: Callable[[Path], object]) -> Callable[[Path], None]:
    def replace(path: Path) -> None:
        path.unlink()
        make(path)

    return replace


def _locked(path: Path) -> Held:
    number = os.open(path, os.O_RDWR)
    fcntl.flock(number, fcntl.LOCK_EX)
    return Held(number)


def _sparse(path: Path) -> None:
    """Keep how the file begins, which may be all that is looked at."""
    with path.open("r+b") as file:
        file.truncate(SPARSE_BYTES)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))


STRANGE: tuple[object, ...] = (
    None,
    "x",
    "",
    -1,
    0,
    1e300,
    10**400,
    True,
    [],
    {},
    [[]],
    "\ud800",
    "0" * 5000,
    1.5,
    -1e-300,
)


def _places(value: object, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if place:
        yield place
    members = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    for key, member in members:
        yield from _places(member, (*place, key))


def _changed(value: Any, seed: int) -> Any:
    """Return a copy with one member deleted, repeated or replaced by something else."""
    chance = random.Random(seed)
    changed = copy.deepcopy(value)
    *way, last = chance.choice(list(_places(value)))
    holder = changed
    for key in way:
        holder = holder[key]
    what = chance.randrange(len(STRANGE) + 2)
    if what < len(STRANGE):
        holder[last] = STRANGE[what]
    elif what == len(STRANGE):
        del holder[last]
    elif isinstance(holder, list):
        holder += [holder[last]] * 3
    else:
        holder[f"{last}_more"] = holder[last]
    return changed


def _wrong_journals(_: str) -> Iterator[Callable[[Path], object]]:
    def change(path: Path, seed: int) -> None:
        envelope = json.loads(path.read_text(encoding="utf-8"))
        content = _changed(envelope["content"], seed)
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        envelope |= {"content": content, "sha256": hashlib.sha256(text.encode()).hexdigest()}
        path.write_text(json.dumps(envelope), encoding="utf-8")

    yield lambda path: path.write_text("[" * 100_000, encoding="utf-8")
    yield from (partial(change, seed=seed) for seed in range(VARIANTS))


def _wrong_ledgers(_: str) -> Iterator[Callable[[Path], object]]:
    def change(path: Path, seed: int) -> None:
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        changed = [json.dumps(line) for line in _changed(lines, seed)]
        path.write_text("\n".join([*changed, changed[-1], ""]), encoding="utf-8")

    yield lambda path: path.write_text("[" * 100_000 + "\n\n", encoding="utf-8")
    yield from (partial(change, seed=seed) for seed in range(VARIANTS))


def _wrong_toml(_: str) -> Iterator[Callable[[Path], object]]:
    from edmctl.profile.hashed_file import HASH, content_hash

    def change(path: Path, seed: int) -> None:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        del table[HASH]
        while True:  # TOML has no null and no number of that size
            changed = _changed(table, seed)
            with suppress(TypeError, UnicodeError, ValueError):
                text = tomli_w.dumps({**changed, HASH: content_hash(changed)})
                path.write_text(text, encoding="utf-8")
                return
            seed += 1000

    yield lambda path: path.write_text("a = " + "[" * 100_000, encoding="utf-8")
    yield from (partial(change, seed=seed) for seed in range(VARIANTS))


def _wrong_benches(_: str) -> Iterator[Callable[[Path], object]]:
    from edmctl.record.bench_file import _hash_of

    def change(path: Path, seed: int) -> None:
        with h5py.File(path, "r+") as file:
            state, arrays = file["state"][:].tobytes(), file["arrays"][:].tobytes()
            text = json.dumps(_changed(json.loads(state), seed)).encode()
            del file["state"]
            file["state"] = np.frombuffer(text, np.uint8)
            file.attrs["sha256"] = _hash_of(text, arrays)

    yield partial(_vast, "arrays")
    yield from (partial(change, seed=seed) for seed in range(2 * VARIANTS))


def _vast(place: str, path: Path) -> None:
    with h5py.File(path, "r+") as file:
        kind = file[place].dtype
        del file[place]
        file.create_dataset(place, (10**13,), kind, chunks=(4096,))


def _wrong_runs(_: str) -> Iterator[Callable[[Path], object]]:
    yield partial(_vast, "/entry/servo/v_cmd")
    for place in ("/entry/servo/time", "/entry/touches", "/entry/results", "/entry/events", "/entry/summary"):
        yield partial(_vast, place)
    yield from (partial(_spoil, seed=seed) for seed in range(VARIANTS))


def _spoil(path: Path, seed: int) -> None:
    """Delete or replace one object of an HDF5 file."""
    chance = random.Random(seed)
    with h5py.File(path, "r+") as file:
        places: list[str] = []
        file.visit(places.append)
        place = chance.choice(sorted(places)[1:])
        kind = chance.randrange(8)
        pipe = f"{path}.pipe"
        if kind == 1:
            os.mkfifo(pipe)
        values: list[object] = [
            None,
            h5py.ExternalLink(pipe, "/"),
            h5py.SoftLink(f"/{place}"),
            "x",
            np.zeros((3, 0)),
            np.full(5, np.nan),
            b"\xff\xfe",
            np.float64(1e308),
        ]
        del file[place]
        if values[kind] is not None:
            file[place] = values[kind]


WRONG: dict[str, Callable[[str], Iterator[Callable[[Path], object]]]] = {
    RUN: _wrong_runs,
    BENCH: _wrong_benches,
    LEDGER: _wrong_ledgers,
    JOURNAL: _wrong_journals,
    CALIBRATION: _wrong_toml,
    DRIFT: _wrong_toml,
}


def _call(words: tuple[str, ...]) -> int:
    """Run a command, or a call of the API; its exit code."""
    import edmctl as api

    if words[0] != "api":
        return edmctl(
            [*words, "--quiet"] if words[0] in {"machine", "approach", "jump-flush"} else list(words)
        )
    name, file = words[1:]
    calls: dict[str, Callable[[], object]] = {
        "open_run": lambda: api.open_run(file).columns("/entry/servo"),
        "calibrate_files": lambda: api.calibrate_files(file),
        "approach": lambda: api.connect(file).approach("cu270"),
        "resume": lambda: api.connect(f"sim:{BENCH}").resume(file),
        "calibration": lambda: api.connect().approach("cu270", calibration=file),
    }
    try:
        calls[name]()
    except EdmError as error:
        return 1 if error.code == "E1000" else 9
    except Exception as bug:
        print(f"{type(bug).__name__}: {bug}", file=sys.stderr)
        return 1
    return 0


def _tried(
    kept: Path, file: str, change: Callable[[Path], object], words: tuple[str, ...]
) -> tuple[float, int, str]:
    """Return the time in s, the exit code (negative: killed) and stderr of one reader of one replaced file."""
    shutil.rmtree("try", ignore_errors=True)
    shutil.copytree(kept, "try")
    path = Path("try").absolute() / file
    held = change(path)
    begin_s = time.monotonic()
    child = os.fork()
    if child == 0:
        code = 1
        with suppress(BaseException):
            os.chdir("try")
            null = os.open(os.devnull, os.O_RDWR)
            err = os.open("../stderr", os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
            os.dup2(null, 0)
            os.dup2(null, 1)
            os.dup2(err, 2)
            code = _call(words)
            sys.stderr.flush()
        os._exit(code & 0xFF)
    status = None
    while status is None and time.monotonic() - begin_s < PATIENCE_S:
        done, found = os.waitpid(child, os.WNOHANG)
        status = found if done else None
        time.sleep(0.002)
    took_s = time.monotonic() - begin_s
    if status is None:
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
    if isinstance(held, Held):
        os.close(held.number)
    return took_s, os.waitstatus_to_exitcode(status), Path("stderr").read_text(errors="replace")


def tried(folder: Path, only: str = "") -> Tally:
    """Try all, print what misses, and return the sum."""
    tally = Tally(readers=sum(map(len, READERS.values())))
    os.environ["EDMCTL_HOME"] = str(folder / "home")
    kept = folder / "kept"
    kept.mkdir()
    make_kept(kept)
    os.chdir(folder)
    kept = kept.rename(folder / "golden")  # where no index of runs leads
    for file, readers in READERS.items():
        if only and only not in file:
            continue
        for kind, change, for_all in replacements(file):
            chosen = readers if for_all else [readers[k] for k in DEEPEST[file]]
            for words in chosen:
                for _ in range(ATTEMPTS):
                    took_s, code, err = _tried(kept, file, change, words)
                    if took_s <= BAR_S or code == 0:
                        break
                tally.tries += 1
                is_hang = code < 0 or (code != 0 and took_s > BAR_S)
                is_bug = not is_hang and (code == 1 or "E1000" in err or "Traceback" in err)
                tally.hangs += is_hang
                tally.bugs += is_bug
                if code != 0:
                    tally.worst_s = max(tally.worst_s, took_s)
                if is_hang or is_bug:
                    last = err.strip()[:300].replace("\n", " | ")
                    print(
                        f"{file}, {kind}, {' '.join(words)}: {took_s:.1f} s, exit {code}: {last}", flush=True
                    )
    return tally
