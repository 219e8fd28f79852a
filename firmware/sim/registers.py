"""The peripherals as the image sees them: what a write does at once, and what a read shows.

All registers stand in one array of words, `r`: the peripherals from 0x4000 0000 on, then a page of the system
control space and one of the DWT, then words of this model. What takes time (timers, conversions, DMA) is done once
in a millisecond by `wiring`. A register of a peripheral whose clock is off (RM0090 §6.3) is not written and reads
0, and that is an error of the image: `ERRORS` counts, `ERROR_AT` keeps the address of the first one.
"""

from __future__ import annotations

import numpy as np

from .addresses import (
    ADC,
    ADC2,
    ADC3,
    ADC_CR2,
    ADC_SR,
    BIF,
    BKE,
    CRC,
    DAC,
    DAC_DHR12R1,
    DAC_DHR12R2,
    DAC_DHR12RD,
    DBP,
    DMA1,
    DMA2,
    DMA_HIFCR,
    DMA_HISR,
    DMA_LIFCR,
    DMA_LISR,
    DMA_STREAM_BYTES,
    DMA_STREAMS,
    EN,
    EXTI,
    EXTI_PR,
    EXTI_RTSR,
    GPIO_BSRR,
    GPIO_IDR,
    GPIO_MODER,
    GPIO_ODR,
    IWDG,
    IWDG_KR,
    IWDG_RLR,
    MODEL_AT,
    MOE,
    MPU_RASR,
    MPU_RBAR,
    MPU_RNR,
    MPU_TYPE,
    NDTR,
    PERIPHERAL_BYTES,
    PERIPHERALS,
    PORT_A,
    PORT_B,
    PORT_E,
    PORT_F,
    PORT_I,
    PVD_LINE,
    PVDE,
    PVDO,
    PWR,
    PWR_CR,
    PWR_CSR,
    RCC,
    RCC_AHB1ENR,
    RCC_APB1ENR,
    RCC_APB2ENR,
    RCC_BDCR,
    RCC_CFGR,
    RCC_CR,
    RCC_CSR,
    RCC_PLLCFGR,
    RESET_FLAGS,
    RMVF,
    RTC,
    RTC_BKP,
    RTC_BKP_END,
    SCB_AIRCR,
    SCB_CFSR,
    SCB_HFSR,
    SPI4,
    SPI_CR1,
    SPI_DR,
    SPI_SR,
    SYSCFG,
    SYSTEM_AT,
    TIM1,
    TIM2,
    TIM3,
    TIM4,
    TIM5,
    TIM6,
    TIM7,
    TIM8,
    TIM9,
    TIM10,
    TIM11,
    TIM12,
    TIM13,
    TIM14,
    TIM_ARR,
    TIM_BDTR,
    TIM_CCER,
    TIM_CCMR1,
    TIM_CCMR2,
    TIM_CNT,
    TIM_CR1,
    TIM_CR2,
    TIM_EGR,
    TIM_SR,
    UG,
    UIF,
    URS,
    USART3,
    USART_DR,
    USART_SR,
    VOSRDY,
    WWDG,
    WWDG_CFR,
    WWDG_CR,
    register,
    stream_at,
    word,
)
from .compiling import compiled
from .steps import TICK_LATE, axis_of, follow, write_step_timer

WORDS = MODEL_AT + 0x100

# Words of the model.
HALFWORDS = MODEL_AT  # executed in this millisecond
LIMIT = MODEL_AT + 1  # so many stop the run
STOP = MODEL_AT + 2  # 1: stop now
BASE_84 = MODEL_AT + 3  # count of TIM2 and TIM5, 84 MHz, at the begin of the millisecond
OFF_AT = MODEL_AT + 4  # 1 + halfwords when MOE went off; 0: it did not
GATE_STARTS = MODEL_AT + 5  # update events that the program asked TIM1 for: a period begins anew
GATE_CHANGES = MODEL_AT + 6  # writes to TIM1 and TIM3
SHIFTED, SHIFTS = MODEL_AT + 7, MODEL_AT + 21  # word of SPI4, and how many since the converter was selected
DAC_CODE = MODEL_AT + 8  # what the actuator's converter holds
ALIVE_EDGES = MODEL_AT + 9  # of the charge pump's pin
WWDG_FED, IWDG_FED, IWDG_RUNS, IWDG_OPEN = MODEL_AT + 10, MODEL_AT + 11, MODEL_AT + 12, MODEL_AT + 13
ERRORS, ERROR_AT = MODEL_AT + 14, MODEL_AT + 15
IS_BROKEN = MODEL_AT + 16  # the break input of TIM1 is active
RESET_ASKED, MPU_SET = MODEL_AT + 17, MODEL_AT + 18
ENGINE, STOP_FUNCTION = MODEL_AT + 19, MODEL_AT + 20  # of Unicorn
SAMPLES_FROM = (
    MODEL_AT + 22
)  # halfwords of this millisecond before the stream of the fast converters was enabled
SCAN_PHASE = MODEL_AT + 23  # clocks of 168 MHz from the begin of a scan of ADC3 to that of the millisecond
SCAN_FROM = MODEL_AT + 24  # conversion of the scan that ADC3's stream was started with
SCANS_END = (
    MODEL_AT + 25
)  # clock of this millisecond at which the last scan ends, if TIM4 is off; 0: none is under way
DEBUG_FREEZE = MODEL_AT + 26  # DBGMCU_APB1_FZ
BDTR_WRITTEN = MODEL_AT + 27  # 1: the level of TIM1's lock stays
MPU_REGIONS = SYSTEM_AT + (0xE00 >> 2)  # base and attributes of eight, where the core has nothing
PINS = MODEL_AT + 32  # levels from outside, a word a port
CLOCK_LOST = PINS + 14  # 1: the ST-LINK gives no clock
SUPPLY_LOW = PINS + 15  # 1: the supply is below the voltage detector's threshold
RELOAD = MODEL_AT + 48  # of the 16 DMA streams: NDTR when they were enabled

HSEON, HSERDY = 1 << 16, 1 << 17
FLAGS_AT = np.array([0, 6, 16, 22])
"""Where the flags of a DMA stream are in its word, by the stream's number modulo 4 (RM0090 §10.5.1)."""
_STREAM_FLAGS, _FCR = 0x3D, 5
SCAN_CLOCKS, CONVERSION_CLOCKS = 10_500, 768
"""Of 168 MHz: from scan to scan of ADC3, and of one conversion in it."""
_TIMERS = (TIM1, TIM2, TIM3, TIM4, TIM5, TIM6, TIM7, TIM8, TIM12, TIM13, TIM14, TIM9, TIM10, TIM11)
_VALID = 0x10  # MPU_RBAR names its region itself
_CS_BIT, _ALIVE_BIT = 1 << 4, 1 << 15  # of PORT_E and PORT_F (firmware/board/stm32f4/pins.h)


def _clocks() -> np.ndarray:
    """Enable register and bit of each page's clock (RM0090 §6.3.10 to 14); register 0: it is always on."""
    found = np.zeros((PERIPHERAL_BYTES >> 10, 2), np.int64)
    for page in range(PORT_A, PORT_I + 1):
        found[page] = RCC_AHB1ENR, page - PORT_A
    for page, bit in ((CRC, 12), (DMA1, 21), (DMA2, 22)):
        found[page] = RCC_AHB1ENR, bit
    for page in range(TIM2, TIM14 + 1):
        found[page] = RCC_APB1ENR, page
    for page, bit in ((WWDG, 11), (USART3, 18), (PWR, 28), (DAC, 29)):
        found[page] = RCC_APB1ENR, bit
    for page, bit in ((TIM1, 0), (TIM8, 1), (SPI4, 13), (SYSCFG, 14), (TIM9, 16), (TIM10, 17), (TIM11, 18)):
        found[page] = RCC_APB2ENR, bit
    found[ADC] = RCC_APB2ENR, 8
    return found


_CLOCKS = _clocks()


def reset_registers(r: np.ndarray, *, keeps_backup: bool) -> None:
    """Values after a reset (the tables at the end of RM0090's chapters), backup registers and DAC kept if asked for.

    What stands outside the chip stays: levels of pins, Unicorn's addresses, and how often the image went wrong.
    """
    backup = r[register(RTC, RTC_BKP) : register(RTC, RTC_BKP_END)].copy()
    outside = r[PINS : PINS + 16].copy()
    engine = r[ENGINE : STOP_FUNCTION + 1].copy()
    errors = r[ERRORS : ERROR_AT + 1].copy()
    dac = r[DAC_CODE]
    csr, freeze = r[register(RCC, RCC_CSR)], r[DEBUG_FREEZE]
    r[:] = 0
    r[PINS : PINS + 16] = outside
    r[ENGINE : STOP_FUNCTION + 1] = engine
    r[ERRORS : ERROR_AT + 1] = errors
    if keeps_backup:
        r[DEBUG_FREEZE] = freeze
        r[register(RTC, RTC_BKP) : register(RTC, RTC_BKP_END)] = backup
        r[DAC_CODE] = dac
        r[register(RCC, RCC_CSR)] = csr
    r[register(PORT_A, GPIO_MODER)], r[register(PORT_B, GPIO_MODER)] = 0xA8000000, 0x280
    r[register(RCC, RCC_CR)], r[register(RCC, RCC_PLLCFGR)], r[register(RCC, RCC_AHB1ENR)] = (
        0x83,
        0x24003010,
        0x00100000,
    )
    r[register(USART3, USART_SR)], r[register(SPI4, SPI_SR)] = 0xC0, 2
    r[register(WWDG, WWDG_CR)] = r[register(WWDG, WWDG_CFR)] = 0x7F
    r[register(IWDG, IWDG_RLR)] = 0xFFF
    for page in _TIMERS:
        r[register(page, TIM_ARR)] = 0xFFFFFFFF if page in (TIM2, TIM5) else 0xFFFF


@compiled
def has_clock(r: np.ndarray, page: int) -> bool:
    """Whether the clock of a peripheral is on."""
    at = _CLOCKS[page, 0]
    if at == 0:
        return True
    bits = r[word(RCC, RCC_CR) + (at >> 2)]
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
    at = word(TIM1, TIM_BDTR)
    if r[at] & MOE:
        r[at] &= ~(MOE)
        r[OFF_AT] = r[HALFWORDS] + 1


@compiled
def write_port(r: np.ndarray, page: int, at: int, value: int) -> None:
    """GPIO (RM0090 §8.4): BSRR sets and resets bits of ODR; the chip select and the alive pin are followed."""
    odr = word(page, GPIO_ODR)
    before = r[odr]
    if at == word(page, GPIO_BSRR):
        r[odr] = (before & ~(value >> 16)) | (value & 0xFFFF)
    elif at != word(page, GPIO_IDR):
        r[at] = value
    changed = before ^ r[odr]
    if page == PORT_E and changed & _CS_BIT and not r[odr] & _CS_BIT:
        r[SHIFTS] = 0
    if page == PORT_E and changed & _CS_BIT and r[odr] & _CS_BIT and r[SHIFTS]:
        control = r[word(SPI4, SPI_CR1)]
        # Master, 16 bits, enabled, MSB first, software slave management (RM0090 §28.5.1); clock of at most 50 MHz.
        if control & 0x0844 != 0x0844 or control & 0x0080 or r[SHIFTS] != 1:
            note_error(r, PERIPHERALS + SPI4 * 0x400)
        else:
            r[DAC_CODE] = r[SHIFTED]
    if page == PORT_F and changed & _ALIVE_BIT:
        r[ALIVE_EDGES] += 1


@compiled
def _locked(r: np.ndarray, offset: int) -> int:
    """Bits of a register of TIM1 that are not written any more (RM0090 §17.4.18, LOCK); its channels are outputs."""
    level = r[word(TIM1, TIM_BDTR)] >> 8 & 3
    if offset == TIM_BDTR:
        return (
            (0x0300 if r[BDTR_WRITTEN] else 0) | (0x70FF if level >= 1 else 0) | (0x0C00 if level >= 2 else 0)
        )
    if offset == TIM_CR2:
        return 0x7F00 if level >= 1 else 0
    if offset == TIM_CCER:
        return 0x2AAA if level >= 2 else 0
    return 0x7878 if level >= 3 and offset in (TIM_CCMR1, TIM_CCMR2) else 0


@compiled
def write_timer(r: np.ndarray, page: int, offset: int, at: int, value: int) -> None:
    """Timers (RM0090 §17, 18, 20): flags are cleared by 0; UG begins a period anew; a break wins over MOE.

    Bits of TIM1 that are locked keep their value; to change them is an error of the image.
    """
    locked = _locked(r, offset) if page == TIM1 else 0
    if (value ^ r[at]) & locked:
        note_error(r, PERIPHERALS + page * 0x400 + offset)
        value = (value & ~locked) | (r[at] & locked)
    if axis_of(page) >= 0:
        follow(r, page, r[HALFWORDS] + r[TICK_LATE])
    if offset == TIM_SR:
        held = BIF if page == TIM1 and r[IS_BROKEN] else 0  # not cleared while the input is active (§17.4.5)
        r[at] &= value | held
    elif offset == TIM_EGR:
        if value & UG:
            r[word(page, TIM_CNT)] = 0
            if not r[word(page, TIM_CR1)] & URS:
                r[word(page, TIM_SR)] |= UIF
            if page == TIM1:
                r[GATE_STARTS] += 1
    elif page == TIM1 and offset == TIM_BDTR:
        if value & MOE and r[IS_BROKEN] and value & BKE:
            value &= ~MOE
        if not value & MOE:
            gate_off(r)
        r[at] = value
        r[BDTR_WRITTEN] = 1
        r[GATE_CHANGES] += 1
    else:
        if page == TIM4 and offset == TIM_CR1 and r[at] & ~value & 1:
            r[SCANS_END] = r[HALFWORDS] + 4 * CONVERSION_CLOCKS
        r[at] = value
        if page in (TIM1, TIM3):
            r[GATE_CHANGES] += 1
    if axis_of(page) >= 0:
        write_step_timer(r, page, offset, value)


@compiled
def write_clocks(r: np.ndarray, at: int, value: int) -> None:
    """RCC (RM0090 §6.3): what is switched on is ready, SWS follows SW; RMVF forgets the causes of resets."""
    offset = (at - word(RCC, RCC_CR)) << 2
    if offset == RCC_CR:
        for on, ready in ((0, 1), (16, 17), (24, 25)):
            value = value & ~(1 << ready) | (value >> on & 1) << ready
        if r[CLOCK_LOST]:
            value &= ~HSERDY
    elif offset == RCC_CFGR:
        value = value & ~0xC | (value & 3) << 2
    elif offset == RCC_BDCR:
        value = value & ~2 | (value & 1) << 1
    elif offset == RCC_CSR:
        flags = r[at] & RESET_FLAGS
        value = (0 if value & RMVF else flags) | (value & 1) | (value & 1) << 1
    r[at] = value


@compiled
def write_dma(r: np.ndarray, page: int, offset: int, at: int, value: int) -> None:
    """DMA (RM0090 §10.5): flags cleared by IFCR; a stream that is enabled takes no new settings."""
    if offset in (DMA_LIFCR, DMA_HIFCR):
        r[at - 2] &= ~(value)
        return
    if offset < DMA_STREAMS:
        return
    stream = (offset - DMA_STREAMS) // DMA_STREAM_BYTES
    control = stream_at(page, stream)
    if at == control:
        if value & EN and not r[control] & EN:
            r[RELOAD + stream + (8 if page == DMA2 else 0)] = r[control + NDTR] & 0xFFFF
            if page == DMA2 and stream == 4:
                r[SAMPLES_FROM] = r[HALFWORDS]
            flags = r[word(page, DMA_LISR if stream < 4 else DMA_HISR)]
            if flags >> FLAGS_AT[stream & 3] & _STREAM_FLAGS:
                note_error(r, PERIPHERALS + page * 0x400 + offset)  # flags must be cleared before (§10.3.17)
    elif r[control] & EN and at != control + _FCR:
        note_error(r, PERIPHERALS + page * 0x400 + offset)
        return
    r[at] = value


@compiled
def note_supply(r: np.ndarray) -> None:
    """The output of the voltage detector has risen: pending, if that edge is asked for (§12.3.3)."""
    if r[word(EXTI, EXTI_RTSR)] & PVD_LINE:
        r[word(EXTI, EXTI_PR)] |= PVD_LINE


@compiled
def put_supply(r: np.ndarray, low: int) -> None:
    """The supply drops below the detector's threshold, or is above it again (§5.2.3)."""
    if low and not r[SUPPLY_LOW] and r[word(PWR, PWR_CR)] & PVDE:
        note_supply(r)
    r[SUPPLY_LOW] = low


@compiled
def scan_place(r: np.ndarray) -> int:
    """Conversion of a scan that ADC3 is at: four of 84 + 12 clocks of 21 MHz, each 62.5 µs (RM0090 §13.5)."""
    if not r[word(TIM4, TIM_CR1)] & 1 and r[HALFWORDS] >= r[SCANS_END]:
        return 0
    place = (r[HALFWORDS] + r[SCAN_PHASE]) % SCAN_CLOCKS // CONVERSION_CLOCKS
    return int(place) if place < 4 else 0


@compiled
def write_slow_converter(r: np.ndarray, at: int, value: int) -> None:
    """CR2 of ADC3: requests begin in the middle of a scan, if one is under way; ADON forgets it (§13.3.1)."""
    before = r[at]
    r[at] = value
    if not before & value & 1:
        r[SCAN_FROM] = 0
        r[SCANS_END] = 0
    elif value & ~before & 0x100:
        r[SCAN_FROM] = scan_place(r)


@compiled
def write_register(r: np.ndarray, offset: int, size: int, value: int) -> None:
    """A write of 1, 2 or 4 bytes to the peripherals."""
    page, at = offset >> 10, offset >> 2
    here = offset & 0x3FC
    if not has_clock(r, page):
        note_error(r, PERIPHERALS + offset)
        return
    if size < 4 and not (page == SPI4 and here == SPI_DR) and not (page == USART3 and here == USART_DR):
        shift = (offset & 3) * 8
        mask = ((1 << 8 * size) - 1) << shift
        is_flag = PORT_A <= page <= PORT_I and here == GPIO_BSRR
        value = (value << shift & mask) if is_flag else (r[at] & ~(mask)) | (value << shift & mask)
    if PORT_A <= page <= PORT_I:
        write_port(r, page, at, value)
    elif page <= TIM14 or page in (TIM1, TIM8, TIM9, TIM10, TIM11):
        write_timer(r, page, here, at, value)
    elif page == RCC:
        write_clocks(r, at, value)
    elif page in (DMA1, DMA2):
        write_dma(r, page, here, at, value)
    elif page == SPI4 and here == SPI_DR:
        r[SHIFTED] = value & 0xFFFF
        r[SHIFTS] += 1
    elif page == SPI4 and here == SPI_SR:
        pass
    elif page == USART3 and here == USART_SR:
        r[at] &= value | 0xFFFFFD9F  # TC, RXNE, CTS, LBD are cleared by writing 0 (§30.6.1)
    elif page == WWDG:
        if here == WWDG_CR:
            r[WWDG_FED] = 1
            value |= r[at] & 0x80  # once on, it stays on (§22.6.1)
            if value & 0x80 and not value & 0x40:
                r[RESET_ASKED] = r[STOP] = 1
        r[at] = value
    elif page == IWDG:
        if here == IWDG_KR:
            r[IWDG_OPEN] = 1 if value == 0x5555 else 0
            if value == 0xAAAA:
                r[IWDG_FED] = 1
            elif value == 0xCCCC:
                r[IWDG_RUNS] = r[IWDG_FED] = 1
        elif r[IWDG_OPEN]:
            r[at] = value
        else:
            note_error(r, PERIPHERALS + offset)
    elif page == EXTI and here == EXTI_PR:  # cleared by writing 1 (§12.3.6)
        r[at] &= ~(value)
    elif page == PWR and here == PWR_CR:
        before, r[at] = r[at], value
        if r[SUPPLY_LOW] and value & ~before & PVDE:
            note_supply(r)
    elif page == ADC and here in (ADC_SR, ADC2 + ADC_SR, ADC3 + ADC_SR):
        r[at] &= value  # flags are cleared by writing 0 (§13.13.1)
    elif page == ADC and here == ADC3 + ADC_CR2:
        write_slow_converter(r, at, value)
    elif page == DAC and here == DAC_DHR12RD:  # both channels at once (§14.5.11)
        r[word(DAC, DAC_DHR12R1)], r[word(DAC, DAC_DHR12R2)] = value & 0xFFF, value >> 16 & 0xFFF
    elif page == RTC and here >= RTC_BKP:
        if r[word(PWR, PWR_CR)] & DBP:  # §5.4.1
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
    if PORT_A <= page <= PORT_I and here == GPIO_IDR:
        modes, outputs = r[word(page, GPIO_MODER)], 0
        for pin in range(16):
            if modes >> 2 * pin & 3 == 1:
                outputs |= 1 << pin
        return int((r[PINS + page - PORT_A] & ~outputs & 0xFFFF) | (r[word(page, GPIO_ODR)] & outputs))
    if page in (TIM2, TIM5) and here == TIM_CNT:
        return int((r[BASE_84] + (r[HALFWORDS] >> 1)) & 0xFFFFFFFF)
    if page == RCC and here == RCC_CR:
        return int(r[at] & ~HSERDY | (0 if r[CLOCK_LOST] else (r[at] & HSEON) << 1))
    if page == USART3 and here == USART_DR:
        r[word(USART3, USART_SR)] &= ~(0x0F)  # PE, FE, NF, ORE: status, then data (§30.6.1)
    if page == PWR and here == PWR_CSR:
        low = r[SUPPLY_LOW] and r[word(PWR, PWR_CR)] & PVDE
        return int(r[at] | VOSRDY | (PVDO if low else 0))
    return int(r[at])


@compiled
def write_system(r: np.ndarray, offset: int, value: int) -> None:
    """System control space (PM0214 §4.3, 4.4, 4.5): reset on request; the rest is looked at elsewhere."""
    at = SYSTEM_AT + (offset >> 2)
    if offset == SCB_AIRCR:
        if value >> 16 == 0x05FA and value & 4:
            r[RESET_ASKED] = r[STOP] = 1
        return
    if SCB_CFSR <= offset <= SCB_HFSR:  # cleared by writing 1
        r[at] &= ~(value)
        return
    if MPU_TYPE <= offset <= MPU_RASR:
        r[MPU_SET] += 1
        region = r[SYSTEM_AT + (MPU_RNR >> 2)]
        if offset == MPU_RBAR:
            if value & _VALID:
                region = value & 0xF
            r[MPU_REGIONS + 2 * region] = value & ~0x1F
        elif offset == MPU_RASR:
            r[MPU_REGIONS + 2 * region + 1] = value
    r[at] = value


def system(r: np.ndarray, offset: int) -> int:
    """Read a register of the system control space."""
    return int(r[SYSTEM_AT + (offset >> 2)])


def set_system(r: np.ndarray, offset: int, value: int) -> None:
    """Set a register of the system control space, as the core does."""
    r[SYSTEM_AT + (offset >> 2)] = value


def mpu_region(r: np.ndarray, region: int) -> tuple[int, int]:
    """Base and attributes of a region of the MPU, as they were set."""
    at = MPU_REGIONS + 2 * region
    return int(r[at]), int(r[at + 1])
