"""Building an image: a small board here, whose sources are written down by the test."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from edmctl.board.board_build import BoardBuild, build_board, toolchain
from edmctl.board.image import read_image
from edmctl.core.boards import STM32F4
from edmctl.core.build import CACHE_VARIABLE
from edmctl.errors import PreconditionError, RunFileError, installing
from edmctl.link.messages import SCHEMA_HASH
from tests.cli.commands import ROOT, command
from tests.needs import BOARD_COMPILERS

SCRIPT = """
MEMORY {
  FLASH (rx) : ORIGIN = 0x08000000, LENGTH = 2M
  RAM (rwx)  : ORIGIN = 0x20000000, LENGTH = 192K
  CCM (rw)   : ORIGIN = 0x10000000, LENGTH = 64K
}
ENTRY(reset_handler)
SECTIONS {
  .vectors : { KEEP(*(.vectors)) KEEP(*(.edm_image)) } >FLASH
  .text : { *(.text*) *(.rodata*) } >FLASH
  .ARM.exidx : { *(.ARM.exidx*) } >FLASH
  .data : { *(.data*) } >RAM AT>FLASH
  .bss (NOLOAD) : { *(.bss*) } >RAM
  .ccm (NOLOAD) : { KEEP(*(.ccm*)) } >CCM
  /DISCARD/ : { *(.ARM.attributes) }
}
"""
PROGRAM = """
#include <stdint.h>
struct image {
  char magic[4]; uint8_t major, minor; uint16_t board; uint32_t schema; uint8_t fw[4]; uint32_t size, crc;
};
__attribute__((used, section(".edm_image"))) const volatile struct image edm_image = {
  {'E', 'D', 'M', 'I'}, 1, 5, 0x0429, %du, {1, 2, 3, 0}, 0, 0};
volatile uint32_t initial[5] = {1, 2, 3, 4, 5};
volatile uint32_t zero[100];
__attribute__((used, section(".ccm"))) volatile uint8_t large[3000];
void reset_handler(void) { for (;;) zero[0] += initial[zero[1]] + edm_image.crc; }
__attribute__((used, section(".vectors"))) const uintptr_t vectors[2] = {0x20000400u, (uintptr_t)reset_handler};
""".replace("%d", str(SCHEMA_HASH))


@pytest.fixture(params=BOARD_COMPILERS)
def compiler(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """Return a folder of sources with one small board."""
    folder = tmp_path / "firmware"
    for part in STM32F4.folders:
        (folder / part).mkdir(parents=True)
    (folder / STM32F4.script).write_text(SCRIPT)
    (folder / "board" / "stm32f4" / "main.c").write_text(PROGRAM)
    return folder


def built(sources: Path, output: Path, compiler: str) -> BoardBuild:
    return build_board(STM32F4, output, compiler, sources)


def test_both_files_hold_one_image_that_knows_its_size_and_check(
    sources: Path, tmp_path: Path, compiler: str
) -> None:
    made = built(sources, tmp_path / "out" / "image.bin", compiler)
    assert [file.name for file in (made.elf, made.bin)] == ["image.elf", "image.bin"]
    image, binary = (read_image(file) for file in (made.elf, made.bin))
    assert image.data == binary.data == made.bin.read_bytes()
    record = image.record
    assert (record.firmware, record.board, image.has_same_schema) == ((1, 2, 3), 0x0429, True)
    assert record.size_bytes == made.bin.stat().st_size
    used = image.used_bytes()
    assert (used["CCM"], used["RAM"]) == (3000, 420)
    assert used["flash"] <= record.size_bytes < used["flash"] + 16


def test_the_same_sources_give_the_same_image(sources: Path, tmp_path: Path, compiler: str) -> None:
    first, second = (built(sources, tmp_path / name, compiler) for name in ("one", "two"))
    assert first.bin.read_bytes() == second.bin.read_bytes()


def test_what_the_compiler_says_is_told(sources: Path, tmp_path: Path, compiler: str) -> None:
    (sources / "board" / "stm32f4" / "main.c").write_text("int main(void) { return wrong; }")
    with pytest.raises(PreconditionError, match="wrong") as caught:
        built(sources, tmp_path / "image", compiler)
    assert caught.value.code == "E8094"
    assert not (tmp_path / "image.elf").exists()


def test_a_program_without_a_record_is_no_image(sources: Path, tmp_path: Path, compiler: str) -> None:
    main = sources / "board" / "stm32f4" / "main.c"
    main.write_text(main.read_text().replace("edm_image", "other"))
    with pytest.raises(PreconditionError, match="no symbol edm_image") as caught:
        built(sources, tmp_path / "image", compiler)
    assert caught.value.code == "E8094"


@pytest.mark.slow
@pytest.mark.needs("ziglang")
def test_the_board_is_built_with_nothing_but_python(tmp_path: Path) -> None:
    """No path, no home, and nothing built before; the bar is 2 min."""
    environ = {"PATH": str(tmp_path), CACHE_VARIABLE: str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command("firmware", "build", "--board", "stm32f4"),
        cwd=tmp_path,
        env=environ,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"cache", "edmctl-stm32f4.elf", "edmctl-stm32f4.bin"}


def test_a_missing_compiler_is_told_with_the_remedy(
    sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(PreconditionError, match="Not installed: arm-none-eabi-gcc") as caught:
        built(sources, tmp_path / "image", "gcc")
    assert (caught.value.code, "apt install gcc-arm-none-eabi" in caught.value.hint) == ("E8093", True)
    assert "CC" not in caught.value.hint


def _program(folder: Path, name: str, body: str) -> Path:
    folder.mkdir(exist_ok=True)
    file = folder / name
    file.write_text(f"#!/bin/sh\n{body}\n")
    file.chmod(0o755)
    return file


def test_a_broken_zig_is_passed_over_for_gcc_and_told_where_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = _program(tmp_path / "python", "python", "exit 3")
    monkeypatch.setattr("edmctl.board.board_build.sys.executable", str(python))
    monkeypatch.setattr("edmctl.board.board_build.importlib.util.find_spec", lambda _: True)
    monkeypatch.setenv("PATH", str(tmp_path))
    for named in (None, "zig"):
        with pytest.raises(PreconditionError, match="does not run") as caught:
            toolchain(STM32F4, named)
        assert caught.value.code == "E8093"
        assert "--force-reinstall ziglang" in caught.value.hint
        assert "--compiler gcc" in caught.value.hint
        assert "CC" not in caught.value.hint
    gcc = _program(tmp_path, "arm-none-eabi-gcc", "echo 1")
    assert toolchain(STM32F4, None).command == (str(gcc),)
    with pytest.raises(PreconditionError, match="does not run"):
        toolchain(STM32F4, "zig")


def test_what_is_in_the_way_of_an_image_is_told(sources: Path, tmp_path: Path, compiler: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "there.bin").mkdir()
    for output, told in (("file/image", "file: File exists"), ("there.elf", "there.bin: Is a directory")):
        with pytest.raises(RunFileError) as caught:
            built(sources, tmp_path / output, compiler)
        assert (caught.value.code, caught.value.exit_code) == ("E9012", 9)
        assert told in caught.value.message
        assert "Errno" not in caught.value.message


def test_what_is_installed_is_quoted_for_every_shell() -> None:
    assert "pip install 'edmctl[cluster]'`" in installing("edmctl[cluster]")
