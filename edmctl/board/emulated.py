"""The image of a board on an emulated chip, in the place of the virtual controller: from a source tree only."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from edmctl import failures
from edmctl.board.board_build import build_board, toolchain
from edmctl.board.image_formats import Elf
from edmctl.core.boards import BOARDS
from edmctl.core.build import cache_folder, files_in, source_folder
from edmctl.link.messages import SCHEMA_HASH
from edmctl.simulator.plant import Plant

PACKAGE = "firmware_sim"
"""Name under which firmware/sim is loaded."""


def emulated_controller(plant: Plant) -> Any:
    """Return the newest image over a plant, built if need be.

    Raises PreconditionError: E8093, E8094 where it cannot be built, E8095 where there is no emulator.
    """
    return controller_class()(plant, image())


def controller_class() -> Any:
    """Return the emulator's controller, a class that takes a plant and an image. Raises PreconditionError E8095."""
    _emulator()
    return importlib.import_module(f"{PACKAGE}.controller").Stm32Controller


@cache
def image(compiler: str | None = None) -> Elf:
    """Return the board's image, built unless that was done before: in the folder where libraries are kept."""
    board = BOARDS["stm32f4"]
    digest = hashlib.sha256(repr(toolchain(board, compiler)).encode())
    for pattern in ("**/*.[ch]", "**/*.ld"):
        for path in files_in(source_folder(), pattern):
            digest.update(path.as_posix().encode() + path.read_bytes())
    kept = cache_folder(os.environ) / f"edmctl-{board.name}-{digest.hexdigest()[:16]}.elf"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=kept.parent, prefix="building-") as folder:
            built = build_board(board, Path(folder) / "image.elf", SCHEMA_HASH, compiler)
            built.elf.replace(kept)
    return Elf(kept.read_bytes())


def _emulator() -> ModuleType:
    """Load firmware/sim, which is not part of the package."""
    if PACKAGE in sys.modules:
        return sys.modules[PACKAGE]
    folder = source_folder() / "sim"
    start = folder / "__init__.py"
    if not start.is_file() or not _has_unicorn():
        raise failures.emulator_missing()
    spec = importlib.util.spec_from_file_location(PACKAGE, start, submodule_search_locations=[str(folder)])
    assert spec is not None
    assert spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules[PACKAGE] = package
    spec.loader.exec_module(package)
    return package


def _has_unicorn() -> bool:
    try:
        importlib.import_module("unicorn")
    except ImportError:
        return False
    return True
