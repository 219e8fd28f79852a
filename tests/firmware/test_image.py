"""The image of the STM32F4 board: both compilers build it, it fits, and what others look for is where it must be."""

from __future__ import annotations

import ctypes as ct
import re
import subprocess
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.firmware.build import compiler, source_folder, source_version
from edmctl.link import messages as m
from tests.firmware.images import COMPILERS, Elf, built, compile_command, sources

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.firmware.build import Build

FLASH, SRAM, CCM = 0x08000000, 0x20000000, 0x10000000
KB = 1024
FLASH_MOST, RAM_MOST, STACK_MOST = 96 * KB, 220 * KB, 2 * KB
FRAME = 108  # of an exception that finds floats in use (PM0214 2.3.7)
VECTORS, TIM7 = 107, 16 + 55


@pytest.fixture(scope="module", params=COMPILERS)
def image(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Elf:
    return Elf(built(request.param, tmp_path_factory.mktemp(request.param)))


def test_it_fits(image: Elf) -> None:
    flash = image.bytes_in(FLASH, FLASH + FLASH_MOST, loaded=True) + image.sections[".data"].size
    ram = image.bytes_in(SRAM, SRAM + 192 * KB) + image.bytes_in(CCM, CCM + 64 * KB)
    assert 30 * KB < flash <= FLASH_MOST
    assert 200 * KB < ram <= RAM_MOST
    assert image.symbols["image_size"] <= FLASH_MOST
    assert image.symbols["image_end"] - FLASH == image.symbols["image_size"]


def test_the_vectors_are_at_the_begin_of_the_flash(image: Elf) -> None:
    vectors = image.words(FLASH, VECTORS)
    assert vectors[0] == image.symbols["main_stack_top"]
    handlers = ["reset", "nmi", "hard_fault", "memory_fault", "bus_fault", "usage_fault"]
    assert [word & ~1 for word in vectors[1:7]] == [
        image.symbols[f"{name}_handler"] & ~1 for name in handlers
    ]
    assert vectors[TIM7] & ~1 == image.symbols["main_tick"] & ~1
    others = [word for i, word in enumerate(vectors) if i > 6 and i != TIM7]
    assert {word & ~1 for word in others} == {image.symbols["other_handler"] & ~1}
    assert all(word & 1 for word in vectors[1:])
    assert image.entry & ~1 == image.symbols["reset_handler"] & ~1


def test_stacks_and_guard(image: Elf) -> None:
    """The guard is below the stack of the main loop, at a multiple of its size."""
    at = {
        name: image.symbols[name] for name in ("guard_begin", "guard_end", "loop_stack_top", "main_stack_top")
    }
    assert at["guard_begin"] % KB == 0
    assert (at["guard_end"] - at["guard_begin"], at["loop_stack_top"] - at["guard_end"]) == (KB, 3 * KB)
    assert at["main_stack_top"] - at["loop_stack_top"] == KB


def test_memory_is_where_dma_and_resets_need_it(image: Elf) -> None:
    """The controller in CCM, which no DMA reaches; every ring in SRAM; what outlasts a reset is not cleared."""
    kept = image.sections[".noinit"]
    assert not kept.loaded
    assert image.symbols["controller"] == CCM
    for name in (
        "wave_ring",
        "rest_ring",
        "gate_edges",
        "ignition_edges",
        "end_edges",
        "slow_ring",
        "rx",
        "tx",
    ):
        assert SRAM <= image.symbols[name] < SRAM + 192 * KB
        assert image.symbols[name] % 2 == 0 or name in ("rx", "tx")
    for name in ("wave_ring", "wave_kept", "kept_words", "crash_word"):
        assert kept.address <= image.symbols[name] < kept.address + kept.size
    assert image.symbols["bss_end"] <= kept.address


def test_the_image_describes_itself(image: Elf) -> None:
    magic, version, schema, firmware, size, crc = image.words(image.symbols["edm_image"], 6)
    assert image.symbols["edm_image"] == FLASH + 0x200
    assert magic == int.from_bytes(b"EDMI", "little")
    assert version == m.PROTO_MAJOR | m.PROTO_MINOR << 8 | 0x0429 << 16
    assert (schema, size) == (m.SCHEMA_HASH, image.symbols["image_size"])
    assert tuple(firmware.to_bytes(4, "little")) == (*source_version(), 0)
    assert crc != 0


def test_tests_find_the_controller_by_its_layout(image: Elf) -> None:
    layout = image.words(image.symbols["edm_layout"], 23)
    assert layout[-1] == image.sections[".ccm"].size <= 64 * KB
    assert len(set(layout)) == 23
    assert max(layout[:-1]) < layout[-1]


def test_nothing_is_calculated_in_double(image: Elf) -> None:
    doubles = re.compile(r"__aeabi_(d|[a-z]+2d|cd)|__.*df\d?$")
    assert [name for name in image.symbols if doubles.match(name)] == []


def _call_graph(folder: Path) -> tuple[dict[str, int], dict[str, set[str]]]:
    """Bytes of stack of each function and whom it calls, as gcc tells them."""
    frames: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    command = [*compile_command("gcc"), "-fcallgraph-info=su", "-c"]
    for path in sources():
        subprocess.run([*command, str(path), "-o", str(folder / f"{path.stem}.o")], check=True)
    for path in folder.glob("*.ci"):
        text = path.read_text(encoding="utf-8")

        def name(title: str, unit: str = path.stem) -> str:
            """Static functions, which are told with their path, get the name of their file."""
            return f"{unit}:{title.split(':')[-1]}" if ":" in title else title

        for title, size in re.findall(
            r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes \(static\)', text
        ):
            frames[name(title)] = int(size)
        for source, target in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            calls.setdefault(name(source), set()).add(name(target))
        assert "dynamic" not in text
    return frames, calls


def _deepest(
    frames: dict[str, int], calls: dict[str, set[str]], name: str, above: tuple[str, ...] = ()
) -> int:
    assert name not in above, f"recursion: {' > '.join([*above, name])}"
    assert name != "__indirect_call"
    called = calls.get(name, set())
    return frames.get(name, 32) + max(
        (_deepest(frames, calls, one, (*above, name)) for one in called), default=0
    )


def test_the_stack_suffices(tmp_path: Path) -> None:
    """From the reset to the deepest call, without recursion; and the tick with its frame on either stack."""
    frames, calls = _call_graph(tmp_path)
    assert "main_run" in frames
    loop = _deepest(frames, calls, "main_run") + _deepest(frames, {}, "startup_begin") + FRAME
    tick = _deepest(frames, calls, "main_tick") + FRAME
    assert 500 < loop <= STACK_MOST
    assert tick <= KB // 2


def test_the_exponential_is_that_of_a_math_library(core: Build, tmp_path: Path) -> None:
    """In whole numbers, so that both compilers have the same bits: rounded rightly wherever double tells how."""
    path = tmp_path / "runtime.so"
    source = source_folder() / "board" / "stm32f4" / "runtime.c"
    own = [f"-D{name}=own_{name}" for name in ("expf", "memcpy", "memset", "memmove", "memcmp")]
    flags = ["-std=c11", "-O2", "-fPIC", "-shared", "-ffreestanding", "-fno-builtin"]
    subprocess.run([*compiler(), *flags, *own, str(source), "-o", str(path)], check=True)
    library = ct.CDLL(str(path))
    library.own_expf.restype, library.own_expf.argtypes = ct.c_float, [ct.c_float]
    random = np.random.default_rng(20)
    x = np.concatenate(
        [
            -2 * np.pi * np.geomspace(0.1, 1000.0, 20_000) * 1e-3,
            random.uniform(-104, 89, 20_000),
            random.normal(0, 1e-4, 5_000),
            [0.0, -0.02, 1e-30, -1e-8, 88.72284, -87.4, -103.9, np.log(2)],
        ]
    ).astype(np.float32)
    with np.errstate(over="ignore", under="ignore"):
        right = np.exp(x.astype(np.float64)).astype(np.float32)
    seen = np.array([library.own_expf(value) for value in x.tolist()], dtype=np.float32)
    assert np.array_equal(seen, right)
    assert library.own_expf(200.0) == np.inf
    assert library.own_expf(-200.0) == 0.0
    assert np.isnan(library.own_expf(np.nan))
