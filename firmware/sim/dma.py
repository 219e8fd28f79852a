"""DMA: a request of a peripheral carries a value into the memory (RM0090 §10.3)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.actuator.compiling import compiled

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
from .registers import FLAGS_AT, RELOAD, note_error

if TYPE_CHECKING:
    import numpy as np


@compiled
def put(
    r: np.ndarray, memory: np.ndarray, dma: int, stream: int, channel: int, source: int, size: int, value: int
) -> None:
    """One request of the register at the address `source`: the stream carries `size` bytes of a value to the memory.

    A stream that is off, or set up for another request, does nothing; with other widths it is an error of the image.
    """
    control = stream_at(dma, stream)
    cr = r[control]
    if not cr & EN or cr >> 25 & 7 != channel or cr >> 6 & 3 != 0 or r[control + PAR] != source:
        return
    width = size >> 1  # 0, 1, 2: bytes, halfwords, words
    if cr >> 13 & 3 != width or cr >> 11 & 3 != width or not cr & MINC:
        note_error(r, source)
        return
    whole = r[RELOAD + stream + (8 if dma == DMA2 else 0)]
    left = r[control + NDTR]
    place = r[control + M0AR] + (whole - left) * size - SRAM_AT
    if place < 0 or place > SRAM_BYTES - size:
        note_error(r, r[control + M0AR])  # no DMA reaches other memory (§2.3.1)
        return
    if size == 4:
        memory[place] = value & 255
        memory[place + 1] = value >> 8 & 255
        memory[place + 2] = value >> 16 & 255
        memory[place + 3] = value >> 24
    elif size == 2:
        memory[place] = value & 255
        memory[place + 1] = value >> 8 & 255
    else:
        memory[place] = value
    r[control + NDTR] = left - 1
    if left == 1:
        r[word(dma, DMA_LISR if stream < 4 else DMA_HISR)] |= TCIF << FLAGS_AT[stream & 3]
        if cr & CIRC:
            r[control + NDTR] = whole
        else:
            r[control] = cr & ~EN
