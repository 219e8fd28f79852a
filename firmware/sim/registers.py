"""The peripherals as the image sees them: what a write does at once, what a read shows. Compiled, called by Unicorn.

All registers stand in one array of words, `r`: the peripherals from 0x4000 0000 on, then a page of the system control space
and one of the DWT, then words of this model (`AUX`). What takes time, timers, conversions, DMA, is done once a millisecond by
`wiring`. A register of a peripheral whose clock is off (RM0090 §7.3) is not written and reads 0, and that is an error of the
image: `ERRORS` counts, `ERROR_AT` keeps the address of the first one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import carray, cfunc, types
from numba.extending import intrinsic

from edmctl.actuator.compiling import compiled

if TYPE_CHECKING:
    from collections.abc import Callable

PERIPHERALS, SYSTEM, TRACE = 0x40000000, 0xE000E000, 0xE0001000
PERIPHERAL_BYTES, PAGE_BYTES = 0x28000, 0x1000
SYSTEM_AT, TRACE_AT, AUX = 0xA000, 0xA400, 0xA800
WORDS = AUX + 0x100

# Words of the model.
HALFWORDS, LIMIT, STOP = (
    AUX,
    AUX + 1,
    AUX + 2,
)  # executed in this millisecond; how many stop the run; whether to stop now
BASE_84 = AUX + 3  # count of TIM2 and TIM5 at the begin of the millisecond
OFF_AT, GATE_STARTS, GATE_CHANGES = (
    AUX + 4,
    AUX + 5,
    AUX + 6,
)  # 1 + halfwords when MOE went off; UG with MOE; settings
SHIFTED, DAC_CODE = AUX + 7, AUX + 8
ALIVE_EDGES = AUX + 9
WWDG_FED, IWDG_FED, IWDG_RUNS, IWDG_OPEN = AUX + 10, AUX + 11, AUX + 12, AUX + 13
ERRORS, ERROR_AT = AUX + 14, AUX + 15
IS_BROKEN = AUX + 16  # the break input of TIM1 is active
RESET_ASKED, MPU_SET = AUX + 17, AUX + 18
ENGINE, STOP_FUNCTION = AUX + 19, AUX + 20  # of Unicorn
SHIFTS = AUX + 21  # words since the converter was selected
SAMPLES_FROM = AUX + 22  # halfwords of this millisecond before the stream of the fast converters was enabled
PINS = AUX + 32  # levels from outside, a word a port
RELOAD = AUX + 48  # of the 16 DMA streams: NDTR when they were enabled

# Places of peripherals: pages of 0x400 bytes.
TIM2, TIM3, TIM4, TIM5, TIM7, TIM13, RTC, WWDG, IWDG, USART3, PWR, DAC = (
    0,
    1,
    2,
    3,
    5,
    7,
    10,
    11,
    12,
    18,
    28,
    29,
)
TIM1, TIM8, ADC, SPI4, TIM10, TIM11 = 64, 65, 72, 77, 81, 82
PORT_A, PORT_C, PORT_D, PORT_E, PORT_F, PORT_G, PORT_I = 128, 130, 131, 132, 133, 134, 136
RCC, FLASH, DMA1, DMA2 = 142, 143, 152, 153
_TIMERS = (TIM1, TIM2, TIM3, TIM4, TIM5, 4, TIM7, TIM8, 6, TIM13, 8, 80, TIM10, TIM11)

# Enable bits of the clocks, page by page: AHB1ENR 0x30, APB1ENR 0x40, APB2ENR 0x44 (RM0090 §7.3.10 to 14); 0: always on.
_CLOCKS = np.zeros((PERIPHERAL_BYTES >> 10, 2), np.int64)
for _page in range(PORT_A, PORT_I + 1):
    _CLOCKS[_page] = 0x30, _page - PORT_A
for _page, _bit in ((140, 12), (DMA1, 21), (DMA2, 22)):
    _CLOCKS[_page] = 0x30, _bit
for _page, _bit in (
    *((n, n) for n in range(9)),
    (WWDG, 11),
    (USART3, 18),
    (PWR, 28),
    (DAC, 29),
):
    _CLOCKS[_page] = 0x40, _bit
for _page, _bit in ((TIM1, 0), (TIM8, 1), (ADC, 8), (SPI4, 13), (78, 14), (80, 16), (TIM10, 17), (TIM11, 18)):
    _CLOCKS[_page] = 0x44, _bit

_GATE_BIT, _CS_BIT, _ALIVE_BIT = 1 << 9, 1 << 4, 1 << 15
MOE, BKE, BKP = 1 << 15, 1 << 12, 1 << 13
BIF = 1 << 7


def register(page: int, offset: int) -> int:
    """Place of a register in `r`."""
    return page * 0x100 + (offset >> 2)


word = compiled(register)
"""The same, compiled."""


def reset_registers(r: np.ndarray, *, keeps_backup: bool) -> None:
    """Values after a reset (the tables at the end of RM0090's chapters); backup registers and pins stay if asked for."""
    backup = r[register(RTC, 0x50) : register(RTC, 0xA0)].copy()
    outside = r[PINS : PINS + 16].copy()
    engine = r[ENGINE : STOP_FUNCTION + 1].copy()
    dac = r[DAC_CODE]
    csr = r[register(RCC, 0x74)]
    r[:] = 0
    r[PINS : PINS + 16] = outside
    r[ENGINE : STOP_FUNCTION + 1] = engine
    if keeps_backup:
        r[register(RTC, 0x50) : register(RTC, 0xA0)] = backup
        r[DAC_CODE] = dac
        r[register(RCC, 0x74)] = csr
    r[register(PORT_A, 0)], r[register(129, 0)] = 0xA8000000, 0x280
    r[register(RCC, 0)], r[register(RCC, 4)], r[register(RCC, 0x30)] = 0x83, 0x24003010, 0x00100000
    r[register(USART3, 0)], r[register(SPI4, 8)] = 0xC0, 2
    r[register(WWDG, 0)] = r[register(WWDG, 4)] = 0x7F
    r[register(IWDG, 8)] = 0xFFF
    for page in _TIMERS:
        r[register(page, 0x2C)] = 0xFFFFFFFF if page in (TIM2, TIM5) else 0xFFFF


@compiled
def has_clock(r: np.ndarray, page: int) -> bool:
    """Whether the clock of a peripheral is on."""
    at = _CLOCKS[page, 0]
    if at == 0:
        return True
    bits = r[word(RCC, 0) + (at >> 2)]
    if page == ADC:
        return bool(bits >> 8 & 7)
    return bool(bits >> _CLOCKS[page, 1] & 1)


@compiled
def note_error(r: np.ndarray, address: int) -> None:
    """Count what no image may do."""
    if r[ERRORS] == 0:
        r[ERROR_AT] = address
    r[ERRORS] += 1


@compiled
def gate_off(r: np.ndarray) -> None:
    """TIM1's main output off (RM0090 §17.3.12)."""
    at = word(TIM1, 0x44)
    if r[at] & MOE:
        r[at] &= ~(MOE)
        r[OFF_AT] = r[HALFWORDS] + 1


@compiled
def write_port(r: np.ndarray, page: int, at: int, value: int) -> None:
    """GPIO (RM0090 §8.4): BSRR sets and resets bits of ODR; the chip select and the alive pin are followed."""
    odr = word(page, 0x14)
    before = r[odr]
    if at == word(page, 0x18):
        r[odr] = (before & ~(value >> 16)) | (value & 0xFFFF)
    elif at != word(page, 0x10):
        r[at] = value
    changed = before ^ r[odr]
    if page == PORT_E and changed & _CS_BIT and not r[odr] & _CS_BIT:
        r[SHIFTS] = 0
    if page == PORT_E and changed & _CS_BIT and r[odr] & _CS_BIT and r[SHIFTS]:
        control = r[word(SPI4, 0)]
        # Master, 16 bits, enabled, MSB first, software slave management (RM0090 §28.5.1); clock of at most 50 MHz.
        if control & 0x0844 != 0x0844 or control & 0x0080 or r[SHIFTS] != 1:
            note_error(r, PERIPHERALS + SPI4 * 0x400)
        else:
            r[DAC_CODE] = r[SHIFTED]
    if page == PORT_F and changed & _ALIVE_BIT:
        r[ALIVE_EDGES] += 1


@compiled
def write_timer(r: np.ndarray, page: int, offset: int, at: int, value: int) -> None:
    """Timers (RM0090 §17, 18, 20): flags are cleared by writing 0; UG begins a period anew; a break wins over MOE."""
    if offset == 0x10:
        r[at] &= value
    elif offset == 0x14:
        if value & 1:
            r[word(page, 0x24)] = 0
            if not r[word(page, 0)] & 4:
                r[word(page, 0x10)] |= 1
            if page == TIM1:
                r[GATE_STARTS] += 1
    elif page == TIM1 and offset == 0x44:
        if value & MOE and r[IS_BROKEN] and value & BKE:
            value &= ~MOE
        if not value & MOE:
            gate_off(r)
        r[at] = value
        r[GATE_CHANGES] += 1
    else:
        r[at] = value
        if page in (TIM1, TIM3):
            r[GATE_CHANGES] += 1


@compiled
def write_clocks(r: np.ndarray, at: int, value: int) -> None:
    """RCC (RM0090 §7.3): what is switched on is ready; RMVF forgets the causes of resets."""
    offset = (at - word(RCC, 0)) << 2
    if offset == 0x00:
        for on, ready in ((0, 1), (16, 17), (24, 25)):
            value = value & ~(1 << ready) | (value >> on & 1) << ready
    elif offset == 0x08:
        value = value & ~0xC | (value & 3) << 2
    elif offset == 0x70:
        value = value & ~2 | (value & 1) << 1
    elif offset == 0x74:
        flags = r[at] & 0xFE000000
        value = (0 if value & 1 << 24 else flags) | (value & 1) | (value & 1) << 1
    r[at] = value


@compiled
def write_dma(r: np.ndarray, page: int, offset: int, at: int, value: int) -> None:
    """DMA (RM0090 §10.5): flags cleared by IFCR; a stream that is enabled takes no new settings."""
    if offset in (0x08, 0x0C):
        r[at - 2] &= ~(value)
        return
    if offset < 0x10:
        return
    stream = (offset - 0x10) // 0x18
    register = (offset - 0x10) % 0x18
    control = word(page, 0x10 + 0x18 * stream)
    if register == 0:
        if value & 1 and not r[control] & 1:
            r[RELOAD + stream + (8 if page == DMA2 else 0)] = r[control + 1] & 0xFFFF
            if page == DMA2 and stream == 4:
                r[SAMPLES_FROM] = r[HALFWORDS]
            flags = r[word(page, 0 if stream < 4 else 4)]
            if flags >> FLAGS_AT[stream & 3] & 0x3D:
                note_error(r, PERIPHERALS + page * 0x400 + offset)  # flags must be cleared before (§10.3.17)
    elif r[control] & 1 and register != 0x14:
        note_error(r, PERIPHERALS + page * 0x400 + offset)
        return
    r[at] = value


FLAGS_AT = np.array([0, 6, 16, 22])


@compiled
def write_register(r: np.ndarray, offset: int, size: int, value: int) -> None:
    """A write of 1, 2 or 4 bytes to the peripherals."""
    page, at = offset >> 10, offset >> 2
    here = offset & 0x3FC
    if not has_clock(r, page):
        note_error(r, PERIPHERALS + offset)
        return
    if size < 4 and not (page == SPI4 and here == 0x0C) and not (page == USART3 and here == 4):
        shift = (offset & 3) * 8
        mask = ((1 << 8 * size) - 1) << shift
        is_flag = PORT_A <= page <= PORT_I and here == 0x18
        value = (value << shift & mask) if is_flag else (r[at] & ~(mask)) | (value << shift & mask)
    if PORT_A <= page <= PORT_I:
        write_port(r, page, at, value)
    elif page < 9 or page in (TIM1, TIM8, 80, TIM10, TIM11):
        write_timer(r, page, here, at, value)
    elif page == RCC:
        write_clocks(r, at, value)
    elif page in (DMA1, DMA2):
        write_dma(r, page, here, at, value)
    elif page == SPI4 and here == 0x0C:
        r[SHIFTED] = value & 0xFFFF
        r[SHIFTS] += 1
    elif page == SPI4 and here == 0x08:
        pass
    elif page == USART3 and here == 0:
        r[at] &= value | 0xFFFFFD9F  # TC, RXNE, CTS, LBD are cleared by writing 0 (§30.6.1)
    elif page == WWDG:
        if here == 0:
            r[WWDG_FED] = 1
            value |= r[at] & 0x80  # once on, it stays on (§22.6.1)
            if value & 0x80 and not value & 0x40:
                r[RESET_ASKED] = r[STOP] = 1
        r[at] = value
    elif page == IWDG:
        if here == 0:
            r[IWDG_OPEN] = 1 if value == 0x5555 else 0
            if value == 0xAAAA:
                r[IWDG_FED] = 1
            elif value == 0xCCCC:
                r[IWDG_RUNS] = r[IWDG_FED] = 1
        elif r[IWDG_OPEN]:
            r[at] = value
        else:
            note_error(r, PERIPHERALS + offset)
    elif page == ADC and here in (0, 0x100, 0x200):
        r[at] &= value  # flags are cleared by writing 0 (§13.13.1)
    elif page == DAC and here == 0x20:  # both channels at once (§14.5.11)
        r[word(DAC, 0x08)], r[word(DAC, 0x14)] = value & 0xFFF, value >> 16 & 0xFFF
    elif page == RTC and here >= 0x50:
        if r[word(PWR, 0)] & 0x100:  # DBP (§5.4.1)
            r[at] = value
        else:
            note_error(r, PERIPHERALS + offset)
    else:
        r[at] = value


@compiled
def read_register(r: np.ndarray, offset: int) -> int:
    """A word of the peripherals."""
    page, at = offset >> 10, offset >> 2
    here = offset & 0x3FC
    if not has_clock(r, page):
        note_error(r, PERIPHERALS + offset)
        return 0
    if PORT_A <= page <= PORT_I and here == 0x10:
        modes, outputs = r[word(page, 0)], 0
        for pin in range(16):
            if modes >> 2 * pin & 3 == 1:
                outputs |= 1 << pin
        return (r[PINS + page - PORT_A] & ~outputs & 0xFFFF) | (r[word(page, 0x14)] & outputs)
    if page in (TIM2, TIM5) and here == 0x24:
        return (r[BASE_84] + (r[HALFWORDS] >> 1)) & 0xFFFFFFFF
    if page == USART3 and here == 4:
        r[word(USART3, 0)] &= ~(0x0F)  # PE, FE, NF, ORE: status, then data (§30.6.1)
    if page == PWR and here == 4:
        return r[at] | 1 << 14  # VOSRDY
    return r[at]


@compiled
def write_system(r: np.ndarray, offset: int, value: int) -> None:
    """System control space (PM0214 §4.3, 4.4, 4.5): reset on request; the rest is looked at elsewhere."""
    at = SYSTEM_AT + (offset >> 2)
    if offset == 0xD0C:
        if value >> 16 == 0x05FA and value & 4:
            r[RESET_ASKED] = r[STOP] = 1
        return
    if 0xD28 <= offset <= 0xD2C:  # CFSR, HFSR: cleared by writing 1
        r[at] &= ~(value)
        return
    if 0xD90 <= offset <= 0xDA0:
        r[MPU_SET] += 1
        if offset == 0xD9C:
            region = r[SYSTEM_AT + (0xD98 >> 2)] if not value & 0x10 else value & 0xF
            r[SYSTEM_AT + (0xE00 >> 2) + 2 * region] = value & ~0x1F
        elif offset == 0xDA0:
            region = r[SYSTEM_AT + (0xD98 >> 2)]
            r[SYSTEM_AT + (0xE00 >> 2) + 2 * region + 1] = value
    r[at] = value


def system(r: np.ndarray, offset: int) -> int:
    """Read a register of the system control space."""
    return int(r[SYSTEM_AT + (offset >> 2)])


def set_system(r: np.ndarray, offset: int, value: int) -> None:
    """Set a register of the system control space, as the core does."""
    r[SYSTEM_AT + (offset >> 2)] = value


def mpu_region(r: np.ndarray, region: int) -> tuple[int, int]:
    """Base and attributes of a region of the MPU, as they were set."""
    at = SYSTEM_AT + (0xE00 >> 2) + 2 * region
    return int(r[at]), int(r[at + 1])


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def call(typing_context: Any, address: Any, arguments: Any) -> tuple[Any, Callable[..., Any]]:
    """Call a C function at an address with whole numbers; its int."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        from llvmlite import ir

        word = ir.IntType(64)
        function = ir.FunctionType(ir.IntType(32), [word] * len(arguments))
        target = builder.inttoptr(given[0], function.as_pointer())
        values = [builder.extract_value(given[1], i) for i in range(len(arguments))]
        return builder.sext(builder.call(target, values), word)

    return types.int64(types.int64, arguments), generate


_READ = types.uint64(types.voidptr, types.uint64, types.uint32, types.voidptr)
_WRITE = types.void(types.voidptr, types.uint64, types.uint32, types.uint64, types.voidptr)
_BLOCK = types.void(types.voidptr, types.uint64, types.uint32, types.voidptr)


@cfunc(_READ, cache=True)
def on_read(_: object, offset: int, size: int, words: object) -> int:
    """Unicorn's read of the peripherals."""
    r = carray(words, (WORDS,), np.int64)
    place = np.int64(offset)
    value = np.int64(read_register(r, place & ~3))
    return value >> (place & 3) * 8 & ((1 << 8 * np.int64(size)) - 1)


@cfunc(_WRITE, cache=True)
def on_write(_: object, offset: int, size: int, value: int, words: object) -> None:
    """Unicorn's write to the peripherals."""
    write_register(carray(words, (WORDS,), np.int64), np.int64(offset), np.int64(size), np.int64(value))


@cfunc(_READ, cache=True)
def on_system_read(_: object, offset: int, size: int, words: object) -> int:
    """Unicorn's read of the system control space."""
    place = np.int64(offset)
    value = np.int64(carray(words, (WORDS,), np.int64)[SYSTEM_AT + (place >> 2)])
    return value >> (place & 3) * 8 & ((1 << 8 * np.int64(size)) - 1)


@cfunc(_WRITE, cache=True)
def on_system_write(_: object, offset: int, size: int, value: int, words: object) -> None:
    """Unicorn's write to the system control space; NVIC_ISER and the like are written as words."""
    r = carray(words, (WORDS,), np.int64)
    place, new = np.int64(offset), np.int64(value)
    if size < 4:
        at = SYSTEM_AT + (place >> 2)
        shift = (place & 3) * 8
        mask = ((1 << 8 * np.int64(size)) - 1) << shift
        r[at] = (r[at] & ~mask) | (new << shift & mask)
        return
    write_system(r, place, new)


@cfunc(_READ, cache=True)
def on_trace_read(_: object, offset: int, size: int, words: object) -> int:
    """DWT_CYCCNT counts what was executed in this millisecond."""
    r = carray(words, (WORDS,), np.int64)
    place = np.int64(offset)
    return r[HALFWORDS] if place == 4 else r[TRACE_AT + (place >> 2)]


@cfunc(_WRITE, cache=True)
def on_trace_write(_: object, offset: int, size: int, value: int, words: object) -> None:
    """Settings of the DWT."""
    carray(words, (WORDS,), np.int64)[TRACE_AT + (np.int64(offset) >> 2)] = value


@cfunc(_BLOCK, cache=True)
def on_block(_: object, address: int, size: int, words: object) -> None:
    """Unicorn's hook of blocks: counts halfwords, and stops the run where it is asked for or has lasted too long.

    Not within a read or write: the instruction would be repeated.
    """
    r = carray(words, (WORDS,), np.int64)
    r[HALFWORDS] += np.int64(size) >> 1
    if r[STOP] or r[HALFWORDS] > r[LIMIT]:
        r[STOP] = 1
        call(r[STOP_FUNCTION], (r[ENGINE],))  # type: ignore[call-arg]
