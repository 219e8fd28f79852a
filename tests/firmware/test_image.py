"""The image of the STM32F4 board: both compilers build it, it fits, and what others look for is where it must be."""

from __future__ import annotations

import ctypes as ct
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edmctl.core.build import compiler, source_folder, source_version
from edmctl.link import messages as m
from tests.firmware.images import BuiltElf, built, compile_command, sources
from tests.needs import BOARD_COMPILERS

FLASH, SRAM, CCM = 0x08000000, 0x20000000, 0x10000000
KB = 1024
FLASH_MOST, RAM_MOST, STACK_MOST = 96 * KB, 220 * KB, 2 * KB
FRAME = 108  # of an exception that finds floats in use (PM0214 2.3.7)
VECTORS, PVD, TIM7 = 107, 16 + 1, 16 + 55


@pytest.fixture(scope="module", params=BOARD_COMPILERS)
def image(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> BuiltElf:
    return BuiltElf(built(request.param, tmp_path_factory.mktemp(request.param)))


def test_it_fits(image: BuiltElf) -> None:
    flash = image.bytes_in(FLASH, FLASH + FLASH_MOST, loaded=True) + image.section(".data").size_bytes
    ram = image.bytes_in(SRAM, SRAM + 192 * KB) + image.bytes_in(CCM, CCM + 64 * KB)
    assert 30 * KB < flash <= FLASH_MOST
    assert 200 * KB < ram <= RAM_MOST
    assert image.at["image_size"] <= FLASH_MOST
    assert image.at["image_end"] - FLASH == image.at["image_size"]


def test_the_page_says_how_much_it_takes(image: BuiltElf, request: pytest.FixtureRequest) -> None:
    """Within 1 KiB: a change of a line in the core is no change of the page."""
    page = (Path(__file__).parents[2] / "docs" / "firmware.md").read_text(encoding="utf-8")
    said = re.search(
        r"flash ([\d.]+) KiB \(gcc\) or ([\d.]+) KiB \(zig\); SRAM ([\d.]+) KiB, CCM ([\d.]+) KiB", page
    )
    assert said is not None
    flash = image.bytes_in(FLASH, FLASH + FLASH_MOST, loaded=True) + image.section(".data").size_bytes
    by_gcc = request.node.callspec.params["image"] == "gcc"
    assert flash / KB == pytest.approx(float(said[1 if by_gcc else 2]), abs=1.0)
    assert image.bytes_in(SRAM, SRAM + 192 * KB) / KB == pytest.approx(float(said[3]), abs=1.0)
    assert image.bytes_in(CCM, CCM + 64 * KB) / KB == pytest.approx(float(said[4]), abs=1.0)


def test_the_vectors_are_at_the_begin_of_the_flash(image: BuiltElf) -> None:
    vectors = image.words(FLASH, VECTORS)
    assert vectors[0] == image.at["main_stack_top"]
    handlers = ["reset", "nmi", "hard_fault", "memory_fault", "bus_fault", "usage_fault"]
    assert [word & ~1 for word in vectors[1:7]] == [image.at[f"{name}_handler"] & ~1 for name in handlers]
    assert vectors[TIM7] & ~1 == image.at["main_tick"] & ~1
    assert vectors[PVD] & ~1 == image.at["supply_handler"] & ~1
    others = [word for i, word in enumerate(vectors) if i > 6 and i not in (PVD, TIM7)]
    assert {word & ~1 for word in others} == {image.at["other_handler"] & ~1}
    assert all(word & 1 for word in vectors[1:])
    assert image.entry & ~1 == image.at["reset_handler"] & ~1


def test_stacks_and_guard(image: BuiltElf) -> None:
    """The main stack is the lowest memory there is, the guard below the main loop's at a multiple of its size."""
    names = ("main_stack_end", "main_stack_top", "guard_begin", "guard_end", "loop_stack_top")
    assert [image.at[name] - SRAM for name in names] == [0, KB, KB, 2 * KB, 5 * KB]


def test_memory_is_where_dma_and_resets_need_it(image: BuiltElf) -> None:
    """The controller in CCM, which no DMA reaches; every ring in SRAM; what outlasts a reset is not cleared."""
    kept = image.section(".noinit")
    assert not kept.has_bytes
    assert image.at["controller"] == CCM
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
        assert SRAM <= image.at[name] < SRAM + 192 * KB
        assert image.at[name] % 2 == 0 or name in ("rx", "tx")
    for name in ("wave_ring", "wave_kept", "kept_words", "crash_word"):
        assert kept.address <= image.at[name] < kept.address + kept.size_bytes
    assert image.at["bss_end"] <= kept.address


def test_the_image_describes_itself(image: BuiltElf) -> None:
    magic, version, schema, firmware, size, crc = image.words(image.at["edm_image"], 6)
    assert image.at["edm_image"] == FLASH + 0x200
    assert magic == int.from_bytes(b"EDMI", "little")
    assert version == m.PROTO_MAJOR | m.PROTO_MINOR << 8 | 0x0429 << 16
    assert (schema, size) == (m.SCHEMA_HASH, image.at["image_size"])
    assert tuple(firmware.to_bytes(4, "little")) == (*source_version(), 0)
    assert crc != 0


def test_tests_find_the_controller_by_its_layout(image: BuiltElf) -> None:
    layout = image.words(image.at["edm_layout"], 23)
    assert layout[-1] == image.section(".ccm").size_bytes <= 64 * KB
    assert len(set(layout)) == 23
    assert max(layout[:-1]) < layout[-1]


def test_nothing_is_calculated_in_double(image: BuiltElf) -> None:
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


@pytest.mark.needs("arm-none-eabi-gcc")
def test_the_stack_suffices(tmp_path: Path) -> None:
    """From the reset to the deepest call, without recursion; and the tick with its frame on either stack."""
    frames, calls = _call_graph(tmp_path)
    assert "main_run" in frames
    loop = _deepest(frames, calls, "main_run") + _deepest(frames, {}, "startup_begin") + FRAME
    tick = _deepest(frames, calls, "main_tick") + FRAME
    assert 500 < loop <= STACK_MOST
    assert tick <= KB // 2


def test_the_exponential_is_that_of_a_math_library(tmp_path: Path) -> None:
    """In whole numbers, so that both compilers have the same bits: rounded rightly wherever double tells how."""
    path = tmp_path / "exp_float.so"
    source = source_folder() / "math" / "exp_float.c"
    flags = ["-std=c11", "-O2", "-fPIC", "-shared", "-ffreestanding", "-fno-builtin"]
    subprocess.run([*compiler(), *flags, str(source), "-o", str(path)], check=True)
    library = ct.CDLL(str(path))
    library.edm_expf.restype, library.edm_expf.argtypes = ct.c_float, [ct.c_float]
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
    seen = np.array([library.edm_expf(value) for value in x.tolist()], dtype=np.float32)
    assert np.array_equal(seen, right)
    assert library.edm_expf(200.0) == np.inf
    assert library.edm_expf(-200.0) == 0.0
    assert np.isnan(library.edm_expf(np.nan))


def test_pulses_are_let_out_in_one_place() -> None:
    """Where the core asks for them; everything else that touches the bit takes it away."""
    folder = source_folder() / "board" / "stm32f4"
    lines = [
        line for path in sorted(folder.glob("*.c")) for line in path.read_text(encoding="utf-8").splitlines()
    ]
    touching = sorted(line.strip() for line in lines if "TIM_BDTR_MOE" in line)
    assert touching == ["TIM1->BDTR &= ~TIM_BDTR_MOE;"] * 2 + ["TIM1->BDTR |= TIM_BDTR_MOE;"]
    gate = (folder / "gate.c").read_text(encoding="utf-8")
    assert "|= TIM_BDTR_MOE" in gate[gate.index("void hal_gate(") : gate.index("/* The least divider")]


def test_every_pin_has_one_net() -> None:
    """The rows of pins.h, as the script reads them that makes the table of the guide."""
    text = (source_folder() / "board" / "stm32f4" / "pins.h").read_text(encoding="utf-8")
    rows = re.findall(
        r'^ {4}PIN\((\w+), +([A-G]), +(\d+), (\w+), +(\d+), (\w+), +([01]), "([^"]+)"\)', text, re.M
    )
    assert len(rows) == text.count("    PIN(") == 34
    nets, pins = {row[0] for row in rows}, {(row[1], int(row[2])) for row in rows}
    assert len(nets) == len(pins) == len(rows)
    modes = {net: (mode, pull, level) for net, _, _, mode, _, pull, level, _ in rows}
    assert {mode for mode, _, _ in modes.values()} == {"INPUT", "OUTPUT", "ALTERNATE", "ANALOG"}
    # What is safe without a wire: the chain broken, contacts open, no ignition, gate and enable low.
    assert {modes[net] for net in ("ESTOP", "DOOR", "HV_SUPPLY", "LEVEL", "LIMITS")} == {
        ("INPUT", "DOWN", "0")
    }
    assert {modes[net][1] for net in ("BREAK_CHAIN", "IGNITION", "GATE_SENSE")} == {"DOWN"}
    assert [net for net, (mode, _, level) in modes.items() if mode == "OUTPUT" and level == "1"] == [
        "DAC_SELECT"
    ]


def _called(elf: BuiltElf) -> Callable[..., tuple[int, int, int]]:
    """A function of the image called on an emulated processor: (r0, r1, s0) after it."""
    import unicorn
    from unicorn import arm_const as arm

    machine = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    machine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    machine.mem_map(FLASH, 1 << 20)
    machine.mem_map(SRAM, 192 * KB)
    machine.mem_write(*elf.image())
    back = FLASH + (1 << 20) - 16

    def call(name: str, *words: int, s0: int = 0) -> tuple[int, int, int]:
        for register, word in zip((arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1), words, strict=False):
            machine.reg_write(register, word)
        machine.reg_write(arm.UC_ARM_REG_S0, s0)
        machine.reg_write(arm.UC_ARM_REG_SP, elf.at["main_stack_top"])
        machine.reg_write(arm.UC_ARM_REG_LR, back | 1)
        machine.emu_start(elf.at[name] | 1, back)
        registers = (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_S0)
        return tuple(machine.reg_read(register) & 0xFFFFFFFF for register in registers)

    return call


def _bits(x: float) -> int:
    return int(np.float32(x).view(np.uint32))


@pytest.mark.needs("unicorn")
def test_the_run_time_has_the_bits_of_the_standard(image: BuiltElf) -> None:
    """Conversions to and from 64 bits come in core registers, the exponential in one of the FPU."""
    call = _called(image)
    for x in (0.0, 0.4, -0.6, 1.0, -1.5, 60000.4, -3e9, 8.1e12, 9.2e18, -9.2e18, 1e30, -1e30):
        low, high, _ = call("__aeabi_f2lz", _bits(x))
        whole = min(max(int(np.float32(x)), -(1 << 63)), (1 << 63) - 1)
        assert (high << 32 | low) == whole & (1 << 64) - 1
    for whole in (0, 1, -1, 16777217, 16777219, -16777217, 1 << 40, (1 << 62) + 1, -(1 << 63), (1 << 63) - 1):
        word = whole & (1 << 64) - 1
        assert call("__aeabi_l2f", word & 0xFFFFFFFF, word >> 32)[0] == _bits(
            float(np.float32(np.int64(whole)))
        )
    for x in (-0.02, -0.125663706, -6.2831855, 0.0, 1.0, -87.0, 42.5):
        assert call("edm_expf", s0=_bits(x))[2] == _bits(np.exp(np.float64(np.float32(x))))
