"""The line: USART3 and its two streams at the pace of their baud, and what goes out on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link.messages import Heartbeat, PulseBlocks, Pulses, Tlm

from .addresses import (
    DMA1,
    DMA_HISR,
    DMA_STREAM_BYTES,
    DMA_STREAMS,
    EN,
    M0AR,
    NDTR,
    PAR,
    PORT_D,
    SRAM_AT,
    SRAM_BYTES,
    TCIF,
    USART3,
    USART_BRR,
    USART_CR1,
    USART_CR3,
    USART_DR,
    USART_SR,
    address,
    stream_at,
    word,
)
from .compiling import compiled
from .dma import put
from .pins import pin_is
from .registers import RELOAD, note_error

if TYPE_CHECKING:
    import numpy as np

    from .circuit import Bench

LINE_BYTES = 1 << 16
"""Bytes that wait for the chip; a power of two."""
UNHURRIED = (Tlm.ID, Pulses.ID, PulseBlocks.ID, Heartbeat.ID | 0x40)
"""Types of frames that nobody waits for."""
TC = 1 << 6
"""Of USART_SR: transmission complete."""
_OVER8, _RX_REQUESTS, _TX_REQUESTS = 1 << 15, 1 << 6, 1 << 7  # of CR1 and CR3
_DATA = address(USART3, USART_DR)
_TX_STREAM = 4
_TX_STREAM_ADDRESS = address(DMA1, DMA_STREAMS + DMA_STREAM_BYTES * _TX_STREAM)


@compiled
def baud_of(r: np.ndarray) -> float:
    """Baud of USART3 (RM0090 §30.3.4), 0 where it does not work."""
    control, divider = r[word(USART3, USART_CR1)], r[word(USART3, USART_BRR)]
    if control & 0x200C != 0x200C or divider == 0:
        return 0.0
    if control & _OVER8:
        divider = (divider & 0xFFF0) + 2 * (divider & 7)
    return float(42e6 / divider)


@compiled
def note_frame(bench: Bench, value: int) -> None:
    """Follow the frames that go out: the type is the byte behind COBS's first."""
    if value == 0:
        if bench.frame_bytes > 2 and not (
            bench.frame_type == UNHURRIED[0]
            or bench.frame_type == UNHURRIED[1]
            or bench.frame_type == UNHURRIED[2]
            or bench.frame_type == UNHURRIED[3]
        ):
            bench.urgent = 1
        bench.frame_bytes = 0
        return
    bench.frame_bytes += 1
    if bench.frame_bytes == 2:
        bench.frame_type = value


@compiled
def carry_line(r: np.ndarray, memory: np.ndarray, bench: Bench, rx: np.ndarray, tx: np.ndarray) -> None:
    """A millisecond of the line, both ways, at its pace. At another baud nothing arrives whole."""
    share = bench.rate
    baud = baud_of(r)
    fits = (
        abs(baud * 100.0 - share) < 0.03 * share and pin_is(r, PORT_D, 8, 2, 7) and pin_is(r, PORT_D, 9, 2, 7)
    )
    bench.receives = min(bench.receives + share, 1_000_000 + share) if bench.rx_head < bench.rx_tail else 0
    while bench.receives >= 1_000_000 and bench.rx_head < bench.rx_tail:
        value = rx[bench.rx_head & (LINE_BYTES - 1)]
        bench.rx_head += 1
        bench.receives -= 1_000_000
        if not fits:
            value ^= 0xA5
        if r[word(USART3, USART_CR3)] & _RX_REQUESTS:
            put(r, memory, DMA1, 1, 4, _DATA, 1, value)
    if bench.line_low:
        r[word(USART3, USART_SR)] |= 2
    control = stream_at(DMA1, _TX_STREAM)
    cr = r[control]
    if not cr & EN:
        bench.sends = 0
        return
    if (
        cr >> 25 & 7 != 7
        or cr >> 6 & 3 != 1
        or r[control + PAR] != _DATA
        or not r[word(USART3, USART_CR3)] & _TX_REQUESTS
    ):
        note_error(r, _TX_STREAM_ADDRESS)
        return
    bench.sends += share
    whole, left = r[RELOAD + _TX_STREAM], r[control + NDTR]
    while bench.sends >= 1_000_000 and left > 0:
        place = r[control + M0AR] + (whole - left) - SRAM_AT
        if place < 0 or place >= SRAM_BYTES:
            note_error(r, r[control + M0AR])
            return
        value = memory[place] if fits else memory[place] ^ 0xA5
        if bench.tx_size < len(tx):
            tx[bench.tx_size] = value
            bench.tx_size += 1
        note_frame(bench, value)
        left -= 1
        bench.sends -= 1_000_000
    r[control + NDTR] = left
    if left == 0:
        r[control] = cr & ~EN
        r[word(DMA1, DMA_HISR)] |= TCIF
        r[word(USART3, USART_SR)] |= TC  # the program clears it, no request does (§30.6.1)
