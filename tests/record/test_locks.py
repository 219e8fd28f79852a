"""Everything runs on disks without locks, and a job warns there."""

from __future__ import annotations

import ast
import errno
import fcntl
import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from edmctl.record import disk
from edmctl.record.bench_file import bench_lock
from edmctl.record.ledger import Ledger, ToolChanged
from tests.cli.commands import SHALLOW, command, environment

WITHOUT_LOCKS = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <sys/stat.h>
int flock(int fd, int op) {
    struct stat told;
    /* As on NFS, where the kernel locks folders by itself. */
    if (fstat(fd, &told) == 0 && S_ISDIR(told.st_mode)) return 0;
    errno = ENOLCK;
    return -1;
}
int fcntl64(int fd, int cmd, ...) {
    va_list all;
    va_start(all, cmd);
    void *what = va_arg(all, void *);
    va_end(all);
    if (cmd == F_SETLK || cmd == F_SETLKW || cmd == F_OFD_SETLK || cmd == F_OFD_SETLKW) {
        errno = ENOLCK;
        return -1;
    }
    int (*real)(int, int, void *) = dlsym(RTLD_NEXT, "fcntl64");
    return real(fd, cmd, what);
}
int fcntl(int fd, int cmd, ...) {
    va_list all;
    va_start(all, cmd);
    void *what = va_arg(all, void *);
    va_end(all);
    return fcntl64(fd, cmd, what);
}
"""


@pytest.fixture
def no_locks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system that answers as NFS does without its lock service."""

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)


def test_a_disk_with_locks_is_known_as_one(tmp_path: Path) -> None:
    assert disk.locks_are_known(tmp_path / "runs" / "of today")
    assert disk.hdf5_locking(tmp_path / "a.h5") is None


@pytest.mark.usefixtures("no_locks")
def test_without_locks_bench_and_ledger_work(tmp_path: Path) -> None:
    assert not disk.locks_are_known(tmp_path)
    assert disk.hdf5_locking(tmp_path / "a.h5") is False
    with bench_lock(tmp_path / "b.h5"):
        pass
    for tool in ("one", "two"):
        Ledger.open(tmp_path).append("SIM-1", ToolChanged(tool))
    entries = [line.entry for line in Ledger.open(tmp_path).lines]
    assert entries == [ToolChanged("one"), ToolChanged("two")]
    assert [path.name for path in tmp_path.iterdir()] == ["ledger.jsonl"]


def test_every_file_is_opened_where_locks_are_thought_of() -> None:
    sources = Path(disk.__file__).parents[1].rglob("*.py")
    texts = ((path, path.read_text(encoding="utf-8")) for path in sources)
    bare = [
        path.name
        for path, text in texts
        if "h5py.File" in text
        for call in ast.walk(ast.parse(text))
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "h5py.File"
    ]
    assert sorted(bare) == ["opening.py", "opening.py", "opening.py"]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler to take the locks away with")
def test_a_job_runs_and_is_listed_where_no_call_of_the_system_locks(tmp_path: Path) -> None:
    (tmp_path / "nolock.c").write_text(WITHOUT_LOCKS, encoding="utf-8")
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-o", "nolock.so", "nolock.c", "-ldl"], cwd=tmp_path, check=True
    )

    def run(*arguments: str) -> dict[str, object]:
        done = subprocess.run(
            command(*arguments, "--json"),
            cwd=tmp_path,
            env=environment(LD_PRELOAD=str(tmp_path / "nolock.so")),
            capture_output=True,
            encoding="utf-8",
            check=False,
        )
        assert done.returncode == 0, done.stderr
        document: dict[str, object] = json.loads(done.stdout)
        return document

    for name in ("a", "b"):
        told = run("machine", *SHALLOW, "--seed", "1", "--run-id", name, "--port", "sim:k.h5", "--quiet")
        assert "W9002" in str(told["warnings"])
    listed = run("run", "list")
    assert str(listed["result"]).count("'status': 'done'") == 2
    assert not [path.name for path in tmp_path.rglob(".*")]
