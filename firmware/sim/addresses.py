"""Where registers are: pages of peripherals and offsets in them, with the names of ST's manuals.

RM0090 §2.3 and the tables at the end of its chapters; for the core PM0214 §4. A page has 0x400 bytes; the first
one is at 0x4000 0000.
"""

from __future__ import annotations

from .compiling import compiled

PERIPHERALS, SYSTEM, TRACE, DEBUG = 0x40000000, 0xE000E000, 0xE0001000, 0xE0042000
PERIPHERAL_BYTES, PAGE_BYTES = 0x28000, 0x1000
SRAM_AT, SRAM_BYTES = 0x20000000, 0x30000
CCM_AT, CCM_BYTES = 0x10000000, 0x10000
SYSTEM_AT, TRACE_AT, MODEL_AT = 0xA000, 0xA400, 0xA800
"""Places of their words, and of those of the model, behind the peripherals."""

# APB1, APB2, AHB1
TIM2, TIM3, TIM4, TIM5, TIM6, TIM7, TIM12, TIM13, TIM14 = range(9)
RTC, WWDG, IWDG, USART3, PWR, DAC = 10, 11, 12, 18, 28, 29
TIM1, TIM8, ADC, SPI4, SYSCFG, EXTI, TIM9, TIM10, TIM11 = 64, 65, 72, 77, 78, 79, 80, 81, 82
PORT_A, PORT_B, PORT_C, PORT_D, PORT_E, PORT_F, PORT_G = range(128, 135)
PORT_I = 136
CRC, RCC, DMA1, DMA2 = 140, 142, 152, 153

# Timers (RM0090 §17.4, 18.4)
TIM_CR1, TIM_CR2, TIM_SMCR, TIM_DIER, TIM_SR, TIM_EGR, TIM_CCMR1, TIM_CCMR2 = range(0x00, 0x20, 4)
TIM_CCER, TIM_CNT, TIM_PSC, TIM_ARR = range(0x20, 0x30, 4)
TIM_CCR1, TIM_CCR2, TIM_CCR4, TIM_BDTR = 0x34, 0x38, 0x40, 0x44
URS, UG, UIF = 4, 1, 1
BIF = 1 << 7
BKE, BKP, MOE = 1 << 12, 1 << 13, 1 << 15
# Ports (§8.4)
GPIO_MODER, GPIO_IDR, GPIO_ODR, GPIO_BSRR, GPIO_AFRL, GPIO_AFRH = 0x00, 0x10, 0x14, 0x18, 0x20, 0x24
# Clocks and resets (§6.3)
RCC_CR, RCC_PLLCFGR, RCC_CFGR = 0x00, 0x04, 0x08
RCC_AHB1ENR, RCC_APB1ENR, RCC_APB2ENR, RCC_BDCR, RCC_CSR = 0x30, 0x40, 0x44, 0x70, 0x74
RESET_FLAGS, RMVF = 0xFE000000, 1 << 24
# Converters: ADC2 and ADC3 at 0x100 and 0x200 (§13.13), the DAC (§14.5)
ADC_SR, ADC_CR1, ADC_CR2, ADC_SMPR2 = 0x00, 0x04, 0x08, 0x10
ADC_SQR1, ADC_SQR3, ADC_DR = 0x2C, 0x34, 0x4C
ADC2, ADC3, ADC_CCR, ADC_CDR = 0x100, 0x200, 0x304, 0x308
DAC_CR, DAC_DHR12R1, DAC_DHR12R2, DAC_DHR12RD = 0x00, 0x08, 0x14, 0x20
# DMA (§10.5); of a stream: its settings, and in words from there its count and two addresses
DMA_LISR, DMA_HISR, DMA_LIFCR, DMA_HIFCR, DMA_STREAMS, DMA_STREAM_BYTES = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x18
EN, CIRC, MINC = 1, 1 << 8, 1 << 10
NDTR, PAR, M0AR = 1, 2, 3
TCIF = 0x20
# Line (§30.6), SPI (§28.5)
USART_SR, USART_DR, USART_BRR, USART_CR1, USART_CR3 = 0x00, 0x04, 0x08, 0x0C, 0x14
SPI_CR1, SPI_SR, SPI_DR = 0x00, 0x08, 0x0C
# Watchdogs (§21.4, 22.6), supply (§5.4), backup registers (§26.6.20)
IWDG_KR, IWDG_PR, IWDG_RLR = 0x00, 0x04, 0x08
WWDG_CR, WWDG_CFR = 0x00, 0x04
PWR_CR, PWR_CSR, DBP, VOSRDY = 0x00, 0x04, 1 << 8, 1 << 14
PVDE, PVDO = 1 << 4, 1 << 2
# External interrupts (§12.3); line 16 is the voltage detector's
EXTI_IMR, EXTI_RTSR, EXTI_PR, PVD_LINE = 0x00, 0x08, 0x14, 1 << 16
RTC_BKP, RTC_BKP_END = 0x50, 0xA0
# The core: interrupts, system control, memory protection (PM0214 §4.3 to 4.5, 4.2); its counter of clocks
NVIC_ISER, NVIC_IPR, SCB_AIRCR, SCB_CFSR, SCB_HFSR = 0x100, 0x400, 0xD0C, 0xD28, 0xD2C
MPU_TYPE, MPU_CTRL, MPU_RNR, MPU_RBAR, MPU_RASR = range(0xD90, 0xDA4, 4)
DWT_CYCCNT = 0x004
# What stands still with a halted core (RM0090 §38.16.4)
DBGMCU_APB1_FZ, WWDG_STOPS, IWDG_STOPS = 0x008, 1 << 11, 1 << 12


def address(page: int, offset: int) -> int:
    """Address of a register, as a DMA stream is told it."""
    return PERIPHERALS + page * 0x400 + offset


def register(page: int, offset: int) -> int:
    """Place of a register in the array of words."""
    return page * 0x100 + (offset >> 2)


word = compiled(register)
"""The same, compiled."""


@compiled
def stream_at(dma: int, stream: int) -> int:
    """Place of the settings of a DMA stream."""
    return word(dma, DMA_STREAMS + DMA_STREAM_BYTES * stream)
