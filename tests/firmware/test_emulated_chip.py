"""The emulated chip: what the image does is without error to it, and what no image may do is counted."""

from __future__ import annotations

import importlib
from typing import Any

import pytest

from edmctl.board.emulated import PACKAGE
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.config import STM32
from tests.needs import EMULATOR

pytestmark = [pytest.mark.slow, EMULATOR]


@pytest.fixture
def bench() -> VirtualBench:
    return open_bench(BenchConfig(controller=STM32), 3)


@pytest.fixture
def chip(bench: VirtualBench) -> Any:
    controller: Any = bench.controller
    return controller.chip


def _module(name: str) -> Any:
    return importlib.import_module(f"{PACKAGE}.{name}")


def test_the_image_starts_and_runs_without_an_error_of_its_own(bench: VirtualBench, chip: Any) -> None:
    bench.controller.advance(200)
    assert [reset.name for reset in chip.resets] == ["POWER_ON"]
    assert chip.errors == (0, None)
    assert 0 < chip.program_counter - 0x0800_0000 < chip.flash.size


def test_a_register_without_its_clock_is_not_written_and_that_is_told(chip: Any) -> None:
    at, registers = _module("addresses"), _module("registers")
    place = at.register(at.TIM14, at.TIM_ARR)
    before = chip.r[place]
    registers.write_register(chip.r, at.address(at.TIM14, at.TIM_ARR) - at.PERIPHERALS, 4, 1)
    assert chip.r[place] == before
    assert chip.errors == (1, 0x4000_202C)


def test_a_stream_that_runs_takes_no_new_settings(chip: Any) -> None:
    at, registers = _module("addresses"), _module("registers")
    stream = at.DMA_STREAMS + 4 * at.DMA_STREAM_BYTES
    control = at.register(at.DMA2, stream)
    assert chip.r[control] & at.EN, "the fast converters sample"
    memory = chip.r[control + at.M0AR]
    registers.write_register(chip.r, at.address(at.DMA2, stream + 4 * at.M0AR) - at.PERIPHERALS, 4, 0)
    assert chip.r[control + at.M0AR] == memory
    assert chip.errors == (1, at.address(at.DMA2, stream + 4 * at.M0AR))


def test_what_the_lock_of_the_gates_timer_holds_is_not_written(chip: Any) -> None:
    """RM0090 §17.4.18: level 3 holds all but the main output and the enable bits, and itself."""
    at, registers = _module("addresses"), _module("registers")

    def changed(offset: int, bits: int) -> bool:
        place, errors = at.register(at.TIM1, offset), chip.errors[0]
        before = int(chip.r[place])
        registers.write_register(chip.r, at.address(at.TIM1, offset) - at.PERIPHERALS, 4, before ^ bits)
        took = int(chip.r[place]) ^ before
        assert took in (0, bits)
        assert chip.errors[0] - errors == (not took)
        return bool(took)

    break_is_low = 1 << 13
    for bits in (0x0100, 0x0200, 0x0001, 1 << 10, 1 << 11, at.BKE, break_is_low, 1 << 14):
        assert not changed(at.TIM_BDTR, bits)
    for offset, bits in (
        (at.TIM_CR2, 1 << 8),
        (at.TIM_CCER, 1 << 1),
        (at.TIM_CCMR1, 1 << 4),
        (at.TIM_CCMR1, 1 << 3),
    ):
        assert not changed(offset, bits)
    assert changed(at.TIM_BDTR, at.MOE)
    assert changed(at.TIM_CCER, 1 << 0)
    assert changed(at.TIM_CCMR1, 1 << 7)  # the reference is cleared from outside, as an isopulse has it


def test_a_reset_does_not_hide_what_the_image_did(chip: Any) -> None:
    at, registers = _module("addresses"), _module("registers")
    registers.write_register(chip.r, at.address(at.TIM14, at.TIM_ARR) - at.PERIPHERALS, 4, 1)
    chip.reset(_module("chip").Reset.PIN)
    assert chip.errors == (1, 0x4000_202C)


CONDITIONAL_LOADS = bytes.fromhex("06bf 0b68 0a68 0124 7047")
"""itte eq; ldreq r3, [r1]; ldreq r2, [r1]; movne r4, #1; bx lr"""
THREE_MOVES = bytes.fromhex("0125 0126 0127")
"""movs r5, #1; movs r6, #1; movs r7, #1"""


def test_a_conditional_load_from_a_page_that_is_new_skips_nothing_behind_it(chip: Any) -> None:
    """Unicorn's virtual TLB would: where it asks for a page in an IT block, the next block begins in that one."""
    from unicorn import arm_const

    moves = (arm_const.UC_ARM_REG_R5, arm_const.UC_ARM_REG_R6, arm_const.UC_ARM_REG_R7)
    flash_at, sram_at, code = _module("chip").FLASH_AT, _module("addresses").SRAM_AT, 0x100000
    after = code + len(CONDITIONAL_LOADS)
    chip.flash[code : after + len(THREE_MOVES)] = list(CONDITIONAL_LOADS + THREE_MOVES)
    chip.r[_module("registers").LIMIT] = 1 << 40
    engine = chip._engine
    for register in moves:
        engine.reg_write(register, 0)
    engine.reg_write(arm_const.UC_ARM_REG_R1, sram_at + 0x20000)
    engine.reg_write(arm_const.UC_ARM_REG_LR, flash_at + after | 1)
    engine.reg_write(arm_const.UC_ARM_REG_XPSR, 0x41000000)  # equal, Thumb
    engine.emu_start(flash_at + code | 1, flash_at + after + len(THREE_MOVES))
    assert [engine.reg_read(register) for register in moves] == [1, 1, 1]


def test_the_flag_of_a_break_stays_while_its_input_is_active(chip: Any) -> None:
    """RM0090 §17.4.5: it can be cleared by software once the input is not active."""
    at, registers = _module("addresses"), _module("registers")
    place, address = at.register(at.TIM1, at.TIM_SR), at.address(at.TIM1, at.TIM_SR) - at.PERIPHERALS
    chip.r[place] |= at.BIF
    chip.r[registers.IS_BROKEN] = 1
    registers.write_register(chip.r, address, 4, 0xFFFFFFFF & ~at.BIF)
    assert chip.r[place] & at.BIF
    chip.r[registers.IS_BROKEN] = 0
    registers.write_register(chip.r, address, 4, 0xFFFFFFFF & ~at.BIF)
    assert not chip.r[place] & at.BIF
