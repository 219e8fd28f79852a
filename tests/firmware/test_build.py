"""Building the core: once for its sources and compiler, and with a word where that cannot be."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from edmctl.core import build
from edmctl.core.build import Build
from edmctl.core.library import RECORD_BYTES, Library, library, loaded
from edmctl.errors import PreconditionError
from edmctl.jobs import batch
from edmctl.jobs.parallel import silent_program
from edmctl.jobs.plan import JobRequest
from edmctl.jobs.surroundings import Unobserved
from edmctl.study import running
from edmctl.study.study import Study


@pytest.fixture
def _quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let compilers optimise nothing."""
    monkeypatch.setattr(build, "_FLAGS", tuple(flag.replace("-O3", "-O0") for flag in build._FLAGS))
    monkeypatch.setattr(build, "_WHOLE", "-g0")


def test_what_was_built_is_found_again(core: Build) -> None:
    again = build.built()
    assert not again.is_new
    assert again.path == core.path


@pytest.mark.expensive("compiles the library")
def test_the_library_is_of_this_protocol_and_says_its_arithmetic() -> None:
    from edmctl.link.messages import SCHEMA_HASH

    assert library().schema_hash() == SCHEMA_HASH
    assert library().real_bytes() == 8
    assert library("float").real_bytes() == 4


@pytest.mark.skipif(sys.platform != "linux", reason="looks into an ELF file")
def test_the_library_needs_no_math_library(core: Build) -> None:
    """Its results do not depend on one then."""
    assert b"\0libm.so" not in core.path.read_bytes()


def test_the_core_is_as_small_as_the_page_says(tmp_path: Path) -> None:
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
        ("false", "E8093", "false does not run: it ends with exit code 1."),
        ("'cc", "E8093", "No closing quotation"),
        ("true", "E8094", "true made no library."),
        ("sh -c 'printf \"\\351\"; exit 3'", "E8093", "it ends with exit code 3."),
        ("sh -c '[ $0 = --version ] || kill -9 $$'", "E8094", "was killed by signal 9."),
        ("sh -c '[ $0 = --version ] || exit 4'", "E8094", "ends with exit code 4."),
        (
            "sh -c '[ $0 = --version ] || { printf \"no \\351\" >&2; exit 1; }'",
            "E8094",
            "could not be built: no \ufffd",
        ),
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


@pytest.mark.usefixtures("_quickly")
@pytest.mark.expensive("compiles the library")
def test_only_regular_sources_are_built_and_a_damaged_library_is_built_again(
    core: Build, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With a blank CC, and old folders of builds in the cache."""
    sources, cache, digest = tmp_path / "firmware", tmp_path / "cache", build.digest_of("double")
    shutil.copytree(build.source_folder(), sources, ignore=shutil.ignore_patterns("sim", "board"))
    (sources / "plant" / ".#plant.c").symlink_to("user@host.1")
    (sources / "plant" / ".plant.c").write_text("no C", encoding="utf-8")
    (sources / "core" / "x.c").mkdir()
    old, new = cache / "building-old", cache / "building-new"
    for folder in (old, new):
        folder.mkdir(parents=True)
    os.utime(old, (0.0, 0.0))
    monkeypatch.setattr(build, "source_folder", lambda: sources)
    monkeypatch.setattr(build, "packaged", lambda *_: tmp_path / "none")  # that of an editable installation
    monkeypatch.setenv(build.CACHE_VARIABLE, str(cache))
    monkeypatch.setenv("CC", "   ")
    made = build.built()
    assert (made.is_new, made.sources, old.exists(), new.exists()) == (True, digest, False, True)
    whole = made.path.read_bytes()
    for spoilt in (whole[:20_000], whole[:20_000] + bytes(20_000) + whole[40_000:], core.path.read_bytes()):
        made.path.write_bytes(spoilt)
        assert not build.is_whole(made.path)
    again = loaded.__wrapped__("double")
    assert (again.build.is_new, again.real_bytes(), build.is_whole(made.path)) == (True, 8, True)
    build.hash_file(made.path).unlink()
    assert not build.is_whole(made.path)
    false = tmp_path / "false-cc"
    false.write_text('#!/bin/sh\nfor last; do :; done\n[ "$1" = --version ] || echo no >"$last"\n')
    false.chmod(0o755)
    monkeypatch.setenv("CC", str(false))
    with pytest.raises(PreconditionError, match="cannot be loaded") as caught:
        loaded.__wrapped__("double")
    assert caught.value.code == "E8094"
    shutil.rmtree(sources)
    with pytest.raises(
        PreconditionError, match=r"sources of edmctl are absent .*: .*firmware: No such"
    ) as caught:
        build.digest_of("double")
    assert (caught.value.code, "--force-reinstall edmctl" in caught.value.hint) == ("E8094", True)


def test_a_wrong_library_of_the_package_stays_and_one_of_the_cache_is_used(
    core: Build, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Whether its hash is wrong, or it is another system's with the right hash."""
    wrong = tmp_path / f"_core{build.SUFFIX}"
    monkeypatch.setattr(build, "packaged", lambda *_: wrong)
    wrong.write_bytes(b"")
    assert loaded.__wrapped__("double").build.path == core.path
    build.hash_file(wrong).write_bytes(build._hash_line(wrong, b""))
    assert build.found().path == wrong
    assert loaded.__wrapped__("double").build.path == core.path
    assert wrong.is_file()


def test_a_whole_library_that_cannot_be_read_for_the_moment_stays(
    core: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(*_: object, **__: object) -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr("ctypes.CDLL", busy)
    monkeypatch.setattr("subprocess.run", busy)
    with pytest.raises(PreconditionError, match="Too many open files"):
        loaded.__wrapped__("double")
    assert build.is_whole(core.path)


def test_without_a_compiler_a_series_ends_before_its_first_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def lacking() -> None:
        raise PreconditionError("There is no C compiler.", hint="Install one.", code="E8093")

    class Counts(Unobserved):
        def runs(self, done: int, total: int) -> None:
            pytest.fail(f"{done} of {total} runs were announced")

    monkeypatch.setattr(batch, "library", lacking)
    monkeypatch.setattr(running, "library", lacking)
    task = batch.Task(JobRequest("cu270", (), None, None), 1, None, "a")
    with pytest.raises(PreconditionError, match="no C compiler"):
        batch.perform_all([task, task], silent_program(), Counts(), lambda *_: pytest.fail("a run was made"))
    study = Study.load("taguchi-l9").start(tmp_path / "study")
    with pytest.raises(PreconditionError, match="no C compiler"):
        study.run(observer=Counts())
    assert len(study.ask(9)) == 9


def test_records_of_other_sizes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(RECORD_BYTES, "Seen", RECORD_BYTES["Seen"] + 8)
    with pytest.raises(OSError, match=r"records Seen .* tools\.generate"):
        Library(library().build)
