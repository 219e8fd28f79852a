"""Build hook: compiles the library of firmware/ into a wheel, with the C compiler of the system or with zig.

EDMCTL_TARGET names another platform to build for, one of `TARGETS` in tools/wheels.py.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ZIG = "ziglang>=0.13,<0.18"


class CoreHook(BuildHookInterface[Any]):
    """Adds the library to a wheel; an editable installation has it in the source tree."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Return zig where there is no C compiler, or one for another platform is needed."""
        from edmctl.core import build

        return [] if not os.environ.get("EDMCTL_TARGET") and build.system_compiler() else [ZIG]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and say what the wheel is for."""
        from edmctl.core import build
        from tools.wheels import TARGETS

        self._made = TemporaryDirectory()
        os.environ.setdefault(build.ZIG_CACHE_VARIABLE, f"{self._made.name}/zig")
        target = TARGETS.get(os.environ.get("EDMCTL_TARGET", ""))
        command = build.compiler(os.environ.get("CC", "")) if target is None else target.command
        place = build.packaged(build.digest_of("double"), build.SUFFIX if target is None else target.suffix)
        library = place if version == "editable" else Path(self._made.name) / place.name
        if version == "editable":
            for other in place.parent.glob("_core-*"):
                other.unlink()
        build.compile_library(command, library)
        if version != "editable":
            for file in (library, build.hash_file(library)):
                build_data["force_include"][str(file)] = f"edmctl/core/{file.name}"
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform if target is None else target.tag}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Delete what was compiled beside the wheel."""
        self._made.cleanup()


sys.path.insert(0, str(Path(__file__).parent))
