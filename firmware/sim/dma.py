"""DMA: a request of a peripheral carries a value into the memory (RM0090 §10.3)."""

from __future__ import annotations

import numpy as np

from .addresses import (
    CIRC,
    DMA2,
    DMA_HISR,
    DMA_LISR,
    EN,
    M0AR,
    MINC,
    NDTR,
    PAR,
    SRAM_AT,
    SRAM_BYTES,
    TCIF,
    stream_at,
    word,
)
from .compiling import compiled
from .registers import FLAGS_AT, RELOAD, note_error


@compiled
def takes(r: np.ndarray, dma: int, stream: int, channel: int, source: int, size: int) -> bool:
    """Whether a stream carries the requests of the register at the address `source`, values of `size` bytes.

    A stream that is off, or set up for another request, does nothing; with other widths it is an error of the image.
    """
    control = stream_at(dma, stream)
    cr = r[control]
    if not cr & EN or cr >> 25 & 7 != channel or cr >> 6 & 3 != 0 or r[control + PAR] != source:
        return False
    width = size >> 1  # 0, 1, 2: bytes, halfwords, words
    if cr >> 13 & 3 != width or cr >> 11 & 3 != width or not cr & MINC:
        note_error(r, source)
        return False
    return True


@compiled
def carry(r: np.ndarray, memory: np.ndarray, dma: int, stream: int, size: int, value: int) -> bool:
    """One value into the memory, by a stream that takes it. False where it takes no more."""
    control = stream_at(dma, stream)
    whole = r[RELOAD + stream + (8 if dma == DMA2 else 0)]
    left = r[control + NDTR]
    place = r[control + M0AR] + (whole - left) * size - SRAM_AT
    if place < 0 or place > SRAM_BYTES - size:
        note_error(r, r[control + M0AR])  # no DMA reaches other memory (§2.3.1)
        return False
    for i in range(size):
        memory[place + i] = value >> 8 * i & 255
    r[control + NDTR] = left - 1
    if left == 1:
        r[word(dma, DMA_LISR if stream < 4 else DMA_HISR)] |= TCIF << FLAGS_AT[stream & 3]
        if not r[control] & CIRC:
            r[control] &= ~EN
            return False
        r[control + NDTR] = whole
    return True


@compiled
def carry_words(r: np.ndarray, memory: np.ndarray, dma: int, stream: int, words: np.ndarray) -> None:
    """One word after the other into the memory, by a stream that takes them; from where it ends a copy each."""
    control, at = stream_at(dma, stream), 0
    while at < len(words) and carry(r, memory, dma, stream, 4, words[at]):
        at += 1
        left = min(r[control + NDTR] - 1, len(words) - at)
        place = (
            r[control + M0AR]
            + (r[RELOAD + stream + (8 if dma == DMA2 else 0)] - r[control + NDTR]) * 4
            - SRAM_AT
        )
        if left > 0 and place % 4 == 0 and 0 <= place <= SRAM_BYTES - 4 * left:
            memory.view(np.uint32)[place >> 2 : (place >> 2) + left] = words[at : at + left]
            r[control + NDTR] -= left
            at += left


@compiled
def put(
    r: np.ndarray, memory: np.ndarray, dma: int, stream: int, channel: int, source: int, size: int, value: int
) -> None:
    """One request of the register at the address `source`: its stream, if it takes it, carries the value."""
    if takes(r, dma, stream, channel, source, size):
        carry(r, memory, dma, stream, size, value)
