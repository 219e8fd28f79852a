"""The image of a board on an emulated chip, in the place of the virtual controller. For trials from a source tree only."""

from __future__ import annotations

import importlib.util
import sys
from typing import TYPE_CHECKING, Any

from edmctl.errors import PreconditionError
from edmctl.firmware.build import source_folder

if TYPE_CHECKING:
    from types import ModuleType

    from edmctl.simulator.plant import Plant

_PACKAGE = "firmware_sim"


def emulated_controller(plant: Plant) -> Any:
    """Return the newest image over a plant, built if need be.

    Raises PreconditionError: E8093, E8094 where it cannot be built, E8095 where there is no emulator.
    """
    import os
    from pathlib import Path

    _emulator()
    image = importlib.import_module(f"{_PACKAGE}.image").Image(Path(os.environ.get("EDM_ELF", "/tmp/u/board.elf")))
    return importlib.import_module(f"{_PACKAGE}.controller").Stm32Controller(plant, image)


def _emulator() -> ModuleType:
    """Load firmware/sim, which no package carries."""
    if _PACKAGE in sys.modules:
        return sys.modules[_PACKAGE]
    folder = source_folder() / "sim"
    start = folder / "__init__.py"
    if not start.is_file() or importlib.util.find_spec("unicorn") is None:
        raise PreconditionError(
            "There is no emulator of the board here.",
            hint='It runs from a source tree with `pip install -e ".[test]"`.',
            code="E8095",
        )
    spec = importlib.util.spec_from_file_location(_PACKAGE, start, submodule_search_locations=[str(folder)])
    assert spec is not None
    assert spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules[_PACKAGE] = package
    spec.loader.exec_module(package)
    return package
