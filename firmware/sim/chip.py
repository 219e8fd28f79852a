"""The processor: memory, exceptions, sleep, reset. One call a millisecond runs its interrupt and its main loop.

Unicorn executes; exceptions are entered and left here, for Unicorn leaves that to whoever uses it: eight words on
the stack of who was interrupted, room for the registers of the floating-point unit as lazy stacking leaves it
(PM0214 §2.3.7).
"""

from __future__ import annotations

import ctypes
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from unicorn import Uc, arm_const, unicorn_const
from unicorn.unicorn_py3.unicorn import uclib

from . import callbacks
from . import registers as reg
from .addresses import (
    CCM_AT,
    CCM_BYTES,
    DEBUG,
    EXTI,
    EXTI_IMR,
    EXTI_PR,
    MPU_CTRL,
    NVIC_IPR,
    NVIC_ISER,
    PAGE_BYTES,
    PERIPHERAL_BYTES,
    PERIPHERALS,
    PVD_LINE,
    RCC,
    RCC_CSR,
    RESET_FLAGS,
    SCB_CFSR,
    SCB_HFSR,
    SRAM_AT,
    SRAM_BYTES,
    SYSTEM,
    SYSTEM_AT,
    TIM7,
    TIM_DIER,
    TIM_SR,
    TRACE,
    register,
    word,
)
from .calling import call
from .compiling import compiled

if TYPE_CHECKING:
    from edmctl.board.image import Elf

FLASH_AT, FLASH_BYTES = 0x08000000, 0x200000
SYSTEM_MEMORY_AT, SYSTEM_MEMORY_BYTES = 0x1FFF7000, 0x1000
_NUMBER = slice(0xA10, 0xA1C)  # of the chip (RM0090 §39.1)
TICK_HALFWORDS = 168_000
LOCKED_UP = 0xFFFFFFFE
_UNMAPPED, _GUARDED = (6, 7, 8), (12, 13, 14)  # Unicorn's status: nothing is there, access is not allowed
_UNTIL = 0xFFFFFFF0  # nothing is there; the end of an exception has an address of its own
_PVD, _TIM7 = 1, 55
_FRAME, _FRAME_WITH_FLOATS = 0x20, 0x68
_VTOR, _SHCSR = 0xD08, 0xD24
_HARD, _MEMORY, _BUS, _USAGE = 3, 4, 5, 6


class Reset(Enum):
    """Why the chip starts, as the flags of RCC_CSR tell it (RM0090 §6.3.21)."""

    POWER_ON = 0x0E000000
    BROWN_OUT = 0x06000000
    PIN = 0x04000000
    SOFTWARE = 0x14000000
    INDEPENDENT_WATCHDOG = 0x24000000
    WINDOW_WATCHDOG = 0x44000000


class ChipFailed(RuntimeError):
    """The image did what stops a chip for good: it never came to its main loop."""


class _Registers:
    """Registers that are read or written in one call: memory for their values, and addresses for Unicorn."""

    def __init__(self, *names: str) -> None:
        self._names = np.array([getattr(arm_const, f"UC_ARM_REG_{n}") for n in names], np.int32)
        self.values = np.zeros(len(names), np.uint32)
        self._places = self.values.ctypes.data + 4 * np.arange(len(names), dtype=np.int64)
        self.names_at, self.places_at = self._names.ctypes.data, self._places.ctypes.data


# Words of `core`: addresses of Unicorn's functions, where the processor stands, and of the sets of registers.
(
    ENGINE,
    START,
    READ,
    READ_SET,
    WRITE_SET,
    PC,
    PC_PLACE,
    HANDLER,
    SLEEPS,
    INTERRUPTED,
    FAULTING,
    SUPPLY_HANDLER,
) = range(12)
SETS = 12
_FRAME_SET, _ENTRY_SET, _LEAVE_SET = SETS, SETS + 2, SETS + 4
PC_ID = arm_const.UC_ARM_REG_PC


@compiled
def _transfer(core: np.ndarray, function: int, registers: int, count: int) -> None:
    call(core[function], (core[ENGINE], core[registers], core[registers + 1], count))


@compiled
def _go(core: np.ndarray, r: np.ndarray, at: int) -> int:
    """Run to the next sleep, the end of the exception or a stop; Unicorn's status."""
    r[reg.STOP] = 0
    status: int = call(core[START], (core[ENGINE], at | 1, _UNTIL, 0, 0))
    call(core[READ], (core[ENGINE], PC_ID, core[PC_PLACE]))
    core[PC] &= 0xFFFFFFFF
    return status


@compiled
def _push(sram: np.ndarray, ccm: np.ndarray, at: int, frame: np.ndarray) -> None:
    memory, place = (sram, at - SRAM_AT) if at >= SRAM_AT else (ccm, at - CCM_AT)
    if 0 <= place <= len(memory) - 32:
        for i in range(8):
            for k in range(4):
                memory[place + 4 * i + k] = frame[i] >> 8 * k & 255


@compiled
def _supply_interrupts(core: np.ndarray, r: np.ndarray, frame: np.ndarray, slept: int) -> bool:
    """Whether the voltage detector's interrupt comes now: pending, enabled, not masked, before the tick."""
    if not r[word(EXTI, EXTI_PR)] & r[word(EXTI, EXTI_IMR)] & PVD_LINE:
        return False
    if not r[SYSTEM_AT + (NVIC_ISER >> 2)] >> _PVD & 1:
        return False
    priorities = SYSTEM_AT + (NVIC_IPR >> 2)
    own = r[priorities + _PVD // 4] >> 8 * (_PVD % 4) + 4 & 15
    if core[INTERRUPTED] and r[priorities + _TIM7 // 4] >> 8 * (_TIM7 % 4) + 4 & 15 <= own:
        return False
    _transfer(core, READ_SET, _FRAME_SET, 12)
    # Who slept with interrupts off is woken, and has them on when the tick comes, which switches none off.
    return bool(slept or core[INTERRUPTED] or not frame[11] & 1)


@compiled
def run_tick(
    core: np.ndarray,
    r: np.ndarray,
    sram: np.ndarray,
    ccm: np.ndarray,
    frame: np.ndarray,
    entry: np.ndarray,
    leave: np.ndarray,
) -> int:
    """The interrupt of TIM7, if it is on, then the main loop until it sleeps or its time is over.

    Where the handler of a fault is to run, it alone does: no interrupt comes before it. That of the voltage
    detector, looked for at the begin of the millisecond, is such a one. An interrupt that has not come to its
    end goes on, and so does a program that works on with interrupts off; the next one waits.

    Returns 0, or Unicorn's status where the processor met what it could not execute; `core[PC]` is where it stands.
    """
    slept = core[SLEEPS]
    core[SLEEPS] = 0
    if core[FAULTING]:
        r[reg.LIMIT] = r[reg.HALFWORDS] + TICK_HALFWORDS
        return _go(core, r, core[PC]) if core[PC] != LOCKED_UP else 0
    r[reg.HALFWORDS], r[reg.LIMIT], r[reg.OFF_AT] = 0, TICK_HALFWORDS, 0
    if _supply_interrupts(core, r, frame, slept):
        # What was interrupted is not kept: the handler is taken for one without an end.
        entry[0], entry[1] = frame[9] & ~6, 0xFFFFFFF9
        entry[2] = frame[10] if frame[9] & 2 else frame[8]
        _transfer(core, WRITE_SET, _ENTRY_SET, 3)
        core[FAULTING] = 1
        return _go(core, r, core[SUPPLY_HANDLER])
    enabled = r[SYSTEM_AT + ((NVIC_ISER + 4) >> 2)] >> (_TIM7 - 32) & 1 and r[word(TIM7, TIM_DIER)] & 1
    if core[INTERRUPTED] or enabled:
        at = core[PC]
        if not core[INTERRUPTED]:
            r[word(TIM7, TIM_SR)] |= 1
            _transfer(core, READ_SET, _FRAME_SET, 12)
            if frame[11] & 1 and not slept:
                return _go(core, r, at)
            sp, control = np.int64(frame[8]), np.int64(frame[9])
            floats = control & 4
            new = (sp - (_FRAME_WITH_FLOATS if floats else _FRAME)) & ~7
            frame[6] = at
            _push(sram, ccm, int(new), frame)
            entry[0] = control & ~6
            entry[1] = 0xFFFFFFF9 if not control & 2 else 0xFFFFFFED if floats else 0xFFFFFFFD
            entry[2] = frame[10] if control & 2 else new
            leave[0], leave[1] = control, sp
            _transfer(core, WRITE_SET, _ENTRY_SET, 3)
            core[INTERRUPTED], at = 1, core[HANDLER]
        status = _go(core, r, at)
        if core[PC] < 0xFFFFFF00:
            return status
        core[INTERRUPTED] = 0
        _transfer(core, WRITE_SET, _LEAVE_SET, 2)
        core[PC] = frame[6]
        frame[6] |= 1
        _transfer(core, WRITE_SET, _FRAME_SET, 10)
    status = _go(core, r, core[PC])
    if status == 0 and not r[reg.STOP]:
        core[SLEEPS] = 1
    return status


class Chip:
    """An STM32F429 with an image in its flash.

    number : 12 bytes, the chip's own. r : registers and words of the model (registers.py). sram, ccm : memory,
    bytes. resets : causes of the resets so far.
    """

    def __init__(self, image: Elf, number: bytes) -> None:
        self.image = image
        self.r = np.zeros(reg.WORDS, np.int64)
        self.sram, self.ccm = np.zeros(SRAM_BYTES, np.uint8), np.zeros(CCM_BYTES, np.uint8)
        self.flash = np.full(FLASH_BYTES, 0xFF, np.uint8)
        at, data = image.image()
        if not FLASH_AT <= at <= FLASH_AT + FLASH_BYTES - len(data):
            raise ValueError(f"the image has something at {at:#x}, which is no flash")
        self.flash[at - FLASH_AT : at - FLASH_AT + len(data)] = np.frombuffer(data, np.uint8)
        self.core = np.zeros(SETS + 6, np.int64)
        self.system_memory = np.full(SYSTEM_MEMORY_BYTES, 0xFF, np.uint8)
        self.system_memory[_NUMBER] = np.frombuffer(number.ljust(12, b"\0")[:12], np.uint8)
        self.resets: list[Reset] = []
        self._closed: set[tuple[int, int]] = set()
        self._start_unicorn()

    def _start_unicorn(self) -> None:
        model = arm_const.UC_CPU_ARM_CORTEX_M4
        self._engine = Uc(
            unicorn_const.UC_ARCH_ARM, unicorn_const.UC_MODE_THUMB | unicorn_const.UC_MODE_MCLASS, model
        )
        self._uc = self._engine._uch
        for at, memory, rights in (
            (FLASH_AT, self.flash, 5),
            (SRAM_AT, self.sram, 3),
            (CCM_AT, self.ccm, 3),
            (SYSTEM_MEMORY_AT, self.system_memory, 1),
        ):
            self._call("uc_mem_map_ptr", at, len(memory), rights, ctypes.c_void_p(memory.ctypes.data))
        words = ctypes.c_void_p(self.r.ctypes.data)
        for at, size, read, write in (
            (PERIPHERALS, PERIPHERAL_BYTES, callbacks.on_read, callbacks.on_write),
            (SYSTEM, PAGE_BYTES, callbacks.on_system_read, callbacks.on_system_write),
            (TRACE, PAGE_BYTES, callbacks.on_trace_read, callbacks.on_trace_write),
            (DEBUG, PAGE_BYTES, callbacks.on_debug_read, callbacks.on_debug_write),
        ):
            self._call(
                "uc_mmio_map",
                at,
                size,
                ctypes.c_void_p(read.address),
                words,
                ctypes.c_void_p(write.address),
                words,
            )
        self.r[reg.ENGINE] = _address(self._uc)
        self.r[reg.STOP_FUNCTION] = _address(uclib.uc_emu_stop)
        self._engine.ctl_set_tlb_mode(unicorn_const.UC_TLB_VIRTUAL)
        fill = self._fill = np.zeros(callbacks.FILL_WORDS, np.int64)
        fill[callbacks.FILL_ENGINE] = self.r[reg.ENGINE]
        fill[callbacks.FILL_READ] = _address(uclib.uc_reg_read)
        fill[callbacks.FILL_WRITE] = _address(uclib.uc_reg_write)
        fill[callbacks.FILL_VALUE_AT] = fill.ctypes.data + 8 * callbacks.FILL_VALUE
        for kind, hook, of_hook in (
            (unicorn_const.UC_HOOK_BLOCK, callbacks.on_block, words),
            (unicorn_const.UC_HOOK_TLB_FILL, callbacks.on_fill, ctypes.c_void_p(fill.ctypes.data)),
        ):
            self._call(
                "uc_hook_add",
                ctypes.byref(ctypes.c_size_t()),
                kind,
                ctypes.c_void_p(hook.address),
                of_hook,
                ctypes.c_uint64(1),
                ctypes.c_uint64(0),
            )
        names = ("R0", "R1", "R2", "R3", "R12", "LR", "PC", "XPSR")
        self._sets = [
            _Registers(*names, "SP", "CONTROL", "MSP", "PRIMASK"),
            _Registers("CONTROL", "LR", "SP"),
            _Registers("CONTROL", "SP"),
        ]
        self.buffers = [registers.values for registers in self._sets]
        core = self.core
        core[ENGINE] = self.r[reg.ENGINE]
        for place, name in enumerate(("emu_start", "reg_read", "reg_read_batch", "reg_write_batch")):
            core[place + 1] = _address(getattr(uclib, f"uc_{name}"))
        core[PC_PLACE] = core.ctypes.data + 8 * PC
        for i, registers in enumerate(self._sets):
            core[SETS + 2 * i : SETS + 2 * i + 2] = registers.names_at, registers.places_at

    def _call(self, name: str, *arguments: object) -> None:
        status = getattr(uclib, name)(self._uc, *arguments)
        if status:
            raise ChipFailed(f"{name} failed: {status}")

    # ---------------------------------------------------------------------------------------------- reset
    def reset(self, cause: Reset) -> None:
        """Start anew: the next tick begins at the reset vector. A loss of supply leaves anything in memory."""
        self.resets.append(cause)
        r = self.r
        loses_all = cause is Reset.POWER_ON
        flags = int(r[register(RCC, RCC_CSR)]) & RESET_FLAGS
        reg.reset_registers(r, keeps_backup=True)
        if loses_all:
            r[reg.DAC_CODE] = 0
            noise = np.random.default_rng(len(self.resets))
            self.sram[:] = noise.integers(0, 256, SRAM_BYTES, np.uint8)
            self.ccm[:] = noise.integers(0, 256, CCM_BYTES, np.uint8)
        r[register(RCC, RCC_CSR)] = (0 if loses_all else flags) | cause.value
        self._open_guard()
        uc = self._engine
        for name in ("CONTROL", "PRIMASK", "BASEPRI", "FAULTMASK"):
            uc.reg_write(getattr(arm_const, f"UC_ARM_REG_{name}"), 0)
        stack, start = self.flash[:8].view("<u4").tolist()
        uc.reg_write(arm_const.UC_ARM_REG_MSP, stack)
        uc.reg_write(arm_const.UC_ARM_REG_SP, stack)
        uc.reg_write(arm_const.UC_ARM_REG_LR, 0xFFFFFFFF)
        uc.reg_write(arm_const.UC_ARM_REG_XPSR, 0x01000000)
        uc.reg_write(arm_const.UC_ARM_REG_FPEXC, 0x40000000)
        self.core[PC] = start & ~1
        for place, interrupt in ((HANDLER, _TIM7), (SUPPLY_HANDLER, _PVD)):
            self.core[place] = int(self.flash[self._vector(16 + interrupt)].view("<u4")[0]) & ~1
        self.core[[SLEEPS, INTERRUPTED, FAULTING]] = 0

    @property
    def program_counter(self) -> int:
        """Address of the instruction that comes next."""
        return int(self.core[PC])

    @property
    def errors(self) -> tuple[int, int | None]:
        """How often the image did what no image may do, and the address at which it did so first."""
        count = int(self.r[reg.ERRORS])
        return count, int(self.r[reg.ERROR_AT]) if count else None

    @property
    def has_set_guard(self) -> bool:
        """Whether the program has written to the MPU since `close_guard`."""
        return bool(self.r[reg.MPU_SET])

    def take_gate_changes(self) -> bool:
        """Whether the timers of the gate were written since this was last asked."""
        changes, self.r[reg.GATE_CHANGES] = self.r[reg.GATE_CHANGES], 0
        return bool(changes)

    # ------------------------------------------------------------------------------------------ exceptions
    def conclude(self, status: int) -> bool:
        """See to what stopped the processor: the handler of a fault is to run at once then. False for a reset."""
        if status and not self.r[reg.RESET_ASKED]:
            self._fault(status)
        return not self.r[reg.RESET_ASKED]

    def close_guard(self) -> None:
        """Take from the memory what a region of the MPU without access covers (PM0214 §4.2)."""
        r = self.r
        r[reg.MPU_SET] = 0
        if not reg.system(r, MPU_CTRL) & 1:
            return
        for region in range(8):
            base, attributes = reg.mpu_region(r, region)
            if attributes & 1 and attributes >> 24 & 7 == 0:
                size = 2 << (attributes >> 1 & 0x1F)
                if size % 0x400 or base % 0x400:
                    raise ChipFailed(f"a guard of {size} bytes at {base:#x}: the emulator closes whole KiB")
                if (base, size) not in self._closed:
                    self._closed.add((base, size))
                    if _is_memory(base):
                        self._call("uc_mem_protect", base, size, 0)
                    else:  # so that the MPU says what it is, and no bus
                        self._call("uc_mem_map", base, size, 0)

    def _vector(self, number: int) -> slice:
        at = reg.system(self.r, _VTOR)
        at = (at - FLASH_AT if at >= FLASH_AT else at) + 4 * number
        return slice(at, at + 4)

    def _fault(self, status: int) -> None:
        """Enter the handler of what could not be executed, on the main stack. A fault in it locks the core up.

        PM0214 §2.4: memory, bus and usage faults where they are enabled (SHCSR), else the hard fault.
        """
        r = self.r
        if self.core[FAULTING]:
            self.core[PC] = LOCKED_UP
            return
        self.core[FAULTING] = 1
        enabled = reg.system(r, _SHCSR)
        number, bits = _HARD, 0
        if status in _GUARDED and enabled >> 16 & 1:
            number, bits = _MEMORY, 0x02
        elif status in _UNMAPPED and enabled >> 17 & 1:
            number, bits = _BUS, 0x0200
        elif status not in (*_GUARDED, *_UNMAPPED) and enabled >> 18 & 1:
            number, bits = _USAGE, 0x00010000
        reg.set_system(r, SCB_CFSR, reg.system(r, SCB_CFSR) | bits)
        if number == _HARD:
            reg.set_system(r, SCB_HFSR, 0x40000000)
        engine = self._engine
        control = engine.reg_read(arm_const.UC_ARM_REG_CONTROL)
        engine.reg_write(arm_const.UC_ARM_REG_CONTROL, control & ~6)
        engine.reg_write(arm_const.UC_ARM_REG_LR, 0xFFFFFFFD if control & 2 else 0xFFFFFFF9)
        self.core[PC] = int(self.flash[self._vector(number)].view("<u4")[0]) & ~1

    def _open_guard(self) -> None:
        for base, size in self._closed:
            if _is_memory(base):
                self._call("uc_mem_protect", base, size, 3)
            else:
                self._call("uc_mem_unmap", base, size)
        self._closed.clear()


def _address(pointer: Any) -> int:
    """Address of a function of Unicorn, or of what it made."""
    return ctypes.cast(pointer, ctypes.c_void_p).value or 0


def _is_memory(at: int) -> bool:
    return SRAM_AT <= at < SRAM_AT + SRAM_BYTES or CCM_AT <= at < CCM_AT + CCM_BYTES
