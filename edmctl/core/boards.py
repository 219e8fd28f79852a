"""The boards that there is firmware for: what an image of one is made of, and how its chip is told from others."""

from __future__ import annotations

from edmctl.dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Memory:
    """A memory of the chip."""

    name: str
    address: int
    size_bytes: int

    def holds(self, address: int) -> bool:
        return self.address <= address < self.address + self.size_bytes


@dataclass(frozen=True, slots=True)
class Board:
    """A board, by its name on the command line and by the number that HELLO and the record of an image tell.

    folders : of sources below firmware/. script : of the linker. device_ids : DBGMCU_IDCODE 11:0 (RM0090 38.6.1).
    zig, gcc : flags for the chip; zig needs its own library for divisions of 64 bits, so it takes no -nostdlib.
    pyocd_target, openocd_config : names in these tools.
    """

    name: str
    number: int
    title: str
    chip: str
    folders: tuple[str, ...]
    script: str
    zig: tuple[str, ...]
    gcc: tuple[str, ...]
    flash: Memory
    memories: tuple[Memory, ...]
    device_ids: frozenset[int]
    pyocd_target: str
    openocd_config: str

    def memory_of(self, address: int) -> str:
        """Name of the memory at an address, "" for none."""
        return next((memory.name for memory in (self.flash, *self.memories) if memory.holds(address)), "")


HOST = "host"
"""Not a board: the core as a library for virtual machines."""

STM32F4 = Board(
    name="stm32f4",
    number=0x0429,
    title="NUCLEO-F429ZI",
    chip="STM32F42x/43x",
    folders=("core", "gen", "math", "board", "board/stm32f4"),
    script="board/stm32f4/f429.ld",
    zig=("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4+vfp4d16sp"),
    gcc=("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-nostdlib"),
    flash=Memory("flash", 0x0800_0000, 2 << 20),
    memories=(Memory("RAM", 0x2000_0000, 192 << 10), Memory("CCM", 0x1000_0000, 64 << 10)),
    device_ids=frozenset({0x419}),
    pyocd_target="stm32f429xi",
    openocd_config="board/st_nucleo_f4.cfg",
)
BOARDS = {board.name: board for board in (STM32F4,)}


def board_of(number: int) -> Board | None:
    """Return the board of a number; None for one that this program does not know."""
    return next((board for board in BOARDS.values() if board.number == number), None)


def board_name(number: int) -> str:
    """Return how people call the board of a number."""
    if number == 0:
        return "virtual controller"
    board = board_of(number)
    return board.title if board else f"unknown board {number}"
