"""Building the core: once for its sources and compiler, and with a word where that cannot be."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from edmctl.core import build
from edmctl.core.library import library, loaded
from edmctl.errors import PreconditionError

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.core.build import Build


def test_what_was_built_is_found_again(core: Build) -> None:
    again = build.built()
    assert not again.is_new
    assert again.path == core.path


def test_the_library_is_of_this_protocol_and_says_its_arithmetic(core: Build) -> None:
    from edmctl.link.messages import SCHEMA_HASH

    assert library().schema_hash() == SCHEMA_HASH
    assert library().real_bytes() == 8
    assert library("float").real_bytes() == 4


@pytest.mark.skipif(sys.platform != "linux", reason="looks into an ELF file")
def test_the_library_needs_no_math_library(core: Build) -> None:
    """Its results do not depend on one then."""
    assert b"\0libm.so" not in core.path.read_bytes()


def test_the_core_is_as_small_as_the_page_says(core: Build, tmp_path: Path) -> None:
    """docs/firmware.md: in a board's arithmetic; 220 KB with a ring of 80 periods at 2.3 kHz, 4000 lines."""
    folder = build.source_folder()
    lines = sum(path.read_text(encoding="utf-8").count("\n") for path in (folder / "core").glob("*.[ch]"))
    assert 2000 < lines <= 4000
    text, program = tmp_path / "size.c", tmp_path / "size"
    text.write_text(
        '#include <stdio.h>\n#include "core.h"\n'
        'int main(void) { return printf("%zu", sizeof(struct edm_controller)) < 0; }\n'
    )
    include = [f"-I{folder / part}" for part in ("core", "gen")]
    subprocess.run([*build.compiler(), "-std=c11", *include, str(text), "-o", str(program)], check=True)
    size = int(subprocess.run([program], capture_output=True, text=True, check=True).stdout)
    ring = 80 * 435 * 4
    page = (folder.parent / "docs/firmware.md").read_text(encoding="utf-8")
    (told,) = re.findall(r"the default\): ([\d ]+) bytes", page)
    assert 50_000 < size <= int(told.replace(" ", "")) + 8  # pointers are longer here
    assert size + ring <= 220_000


def test_without_a_compiler_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    build.compiler.cache_clear()
    with pytest.raises(PreconditionError, match="no C compiler") as caught:
        build.built(environ={})
    build.compiler.cache_clear()
    assert (caught.value.code, "pip install ziglang`" in caught.value.hint) == ("E8093", True)


@pytest.mark.parametrize(
    ("command", "code", "reason"),
    [
        ("no-such-compiler", "E8093", "no-such-compiler does not run: No such file or directory."),
        ("false", "E8093", "false does not run: with --version it ends with exit code 1."),
        ("'cc", "E8093", "No closing quotation"),
        ("true", "E8094", "true made no library."),
    ],
)
def test_a_compiler_that_does_not_compile_is_told(
    command: str, code: str, reason: str, tmp_path: Path
) -> None:
    with pytest.raises(PreconditionError) as caught:
        build.built(environ={"CC": command, build.CACHE_VARIABLE: str(tmp_path / "cache")})
    assert caught.value.code == code
    assert reason in str(caught.value)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_folder_that_takes_no_library_is_told(tmp_path: Path) -> None:
    blocked = tmp_path / "cache"
    blocked.write_text("a file", encoding="utf-8")
    with pytest.raises(PreconditionError, match=r"cannot be kept in .*cache: File exists") as caught:
        build.built(environ={build.CACHE_VARIABLE: str(blocked)})
    assert (caught.value.code, build.CACHE_VARIABLE in caught.value.hint) == ("E8094", True)


def test_a_damaged_library_is_built_anew_and_a_false_one_told(
    core: Build, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(build.CACHE_VARIABLE, str(tmp_path))
    (tmp_path / core.path.name).write_bytes(b"damaged")
    again = loaded.__wrapped__("double")
    assert (again.build.is_new, again.real_bytes()) == (True, 8)
    false = tmp_path / "false-cc"
    false.write_text('#!/bin/sh\nfor last; do :; done\n[ "$1" = --version ] || echo no >"$last"\n')
    false.chmod(0o755)
    monkeypatch.setenv("CC", str(false))
    with pytest.raises(PreconditionError, match="cannot be loaded") as caught:
        loaded.__wrapped__("double")
    assert caught.value.code == "E8094"
