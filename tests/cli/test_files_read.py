"""Every option that reads a file, given what is none: a message and an exit code, soon and in little memory."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from tests.cli.commands import CU270, Here

READERS = {
    "profile": ("machine", "--profile", "FILE", "--dry-run"),
    "setup": ("machine", "--profile", CU270, "--setup", "FILE", "--dry-run"),
    "calibration": ("machine", "--profile", CU270, "--calibration", "FILE", "--dry-run"),
    "resume": ("machine", "--resume", "FILE"),
    "bench": ("machine", "--profile", CU270, "--port", "sim:FILE"),
    "checked": ("profile", "check", "FILE"),
    "shown": ("profile", "show", "FILE"),
    "extended": ("profile", "check", "child.toml"),
    "places": ("profile", "check", "array.toml"),
    "record": ("calibrate", "--from", "FILE"),
    "lever": ("calibrate", "--lever", "FILE"),
    "validation": ("calibrate", "--from", "FILE", "--validate", "FILE"),
    "waveform": ("simulate", "actuator", "csv", "--from", "FILE"),
    "model": ("simulate", "actuator", "sine", "--calibration", "FILE"),
    "served": ("simulate", "serve", "--bench", "FILE", "--for", "0"),
    "served secret": ("simulate", "serve", "--socket", ":0", "--secret-file", "FILE", "--for", "0"),
    "secret": ("doctor", "--port", "socket://localhost:9", "--setup", "secret.toml"),
    "doctor": ("doctor", "--setup", "FILE"),
    "run show": ("run", "show", "FILE"),
    "run follow": ("run", "show", "FILE", "--follow"),
    "run explain": ("run", "explain", "FILE"),
    "run plot": ("run", "plot", "FILE"),
    "run export": ("run", "export", "FILE", "-t", "servo"),
    "run compare": ("run", "compare", "FILE", "FILE"),
    "run recover": ("run", "recover", "FILE"),
}
KINDS = ("pipe", "endless", "folder", "long", "vanished")


def made(kind: str) -> str:
    """Make what is no file that anybody could read; its name."""
    name = f"{kind}.toml"
    if kind == "pipe":
        os.mkfifo(name)
    elif kind == "endless":
        return "/dev/zero"
    elif kind == "folder":
        Path(name).mkdir()
    elif kind == "long":
        with Path(name).open("wb") as file:
            file.truncate(1 << 30)
    else:
        Path(name).symlink_to("gone.toml")
    return name


def name_in_files(name: str) -> None:
    """Write the files that name another one."""
    for file, text in {
        "child.toml": f'extends = "{name}"\n',
        "array.toml": f'extends = "cu270"\n[[sites]]\nkind = "file"\npath = "{name}"\n',
        "secret.toml": f'[link]\nsecret_file = "{name}"\n',
    }.items():
        Path(file).write_text(text, encoding="utf-8")


def is_refused(reader: str, kind: str) -> bool:
    """Whether that cannot be used: a bench that is not there is made."""
    return not (kind == "vanished" and reader in {"bench", "served"})


@pytest.mark.parametrize(
    ("reader", "kind"), [(reader, kind) for reader in READERS for kind in KINDS if is_refused(reader, kind)]
)
def test_what_is_no_file_is_refused(here: Here, reader: str, kind: str) -> None:
    name = made(kind)
    name_in_files(name)
    before = {path: path.lstat().st_size for path in Path().iterdir()}
    said = here(*(argument.replace("FILE", name) for argument in READERS[reader]))
    assert said.exit_code in {2, 3, 8, 9}, (said.out, said.err)
    assert re.match(r"(profile: .*\n)?error\[E", said.err), said.err
    assert "Internal" not in said.err
    assert {path: path.lstat().st_size for path in Path().iterdir()} == before
