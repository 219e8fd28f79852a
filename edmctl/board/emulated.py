"""The image of a board on an emulated chip, in the place of the virtual controller: from a source tree only."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.board.board_build import build_board, toolchain
from edmctl.board.image import Elf
from edmctl.core.boards import STM32F4
from edmctl.core.build import cache_folder, files_in, source_folder
from edmctl.simulator.plant import Plant

PACKAGE = "firmware_sim"
"""Name under which firmware/sim is loaded."""


def emulated_controller(plant: Plant) -> Any:
    """Return the newest image over a plant, built if need be.

    Raises PreconditionError: E8093, E8094 if it cannot be built, E8095 without an emulator.
    """
    return controller_class()(plant, image())


def controller_class() -> Any:
    """Return the emulator's controller, a class that takes a plant and an image. Raises PreconditionError E8095."""
    if PACKAGE not in sys.modules:
        folder = source_folder() / "sim"
        start = folder / "__init__.py"
        try:
            importlib.import_module("unicorn")
        except ImportError as error:
            raise failures.emulator_missing() from error
        if not start.is_file():
            raise failures.emulator_missing()
        spec = importlib.util.spec_from_file_location(
            PACKAGE, start, submodule_search_locations=[str(folder)]
        )
        assert spec is not None
        assert spec.loader is not None
        package = importlib.util.module_from_spec(spec)
        sys.modules[PACKAGE] = package
        spec.loader.exec_module(package)
    return importlib.import_module(f"{PACKAGE}.controller").Stm32Controller


@cache
def image(compiler: str | None = None) -> Elf:
    """Return the board's image, from the folder of the compiled libraries or built into it."""
    digest = hashlib.sha256(repr(toolchain(STM32F4, compiler)).encode())
    for pattern in ("**/*.[ch]", "**/*.ld"):
        for path in files_in(source_folder(), pattern):
            digest.update(path.as_posix().encode() + path.read_bytes())
    kept = cache_folder(os.environ) / f"edmctl-{STM32F4.name}-{digest.hexdigest()[:16]}.elf"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=kept.parent, prefix="building-") as folder:
            build_board(STM32F4, Path(folder) / "image.elf", compiler).elf.replace(kept)
    return Elf(kept.read_bytes())
