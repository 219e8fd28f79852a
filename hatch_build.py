"""Build hook: compiles the library of firmware/ into the package, with the C compiler of the system or with zig.

EDMCTL_TARGET names another platform to build for, one of `edmctl.core.build.TARGETS` (tools/wheels.py).
"""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ZIG = "ziglang>=0.13,<0.18"


class CoreHook(BuildHookInterface[Any]):
    """Adds the library to a wheel, or to the source tree of an editable installation."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Return zig where there is no C compiler, or one for another platform is needed."""
        from edmctl.core import build

        return [] if not os.environ.get("EDMCTL_TARGET") and build.system_compiler() else [ZIG]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and say what the wheel is for."""
        from edmctl.core import build

        target = build.TARGETS.get(os.environ.get("EDMCTL_TARGET", ""))
        command = build.compiler(os.environ.get("CC", "")) if target is None else target.command
        library = build.packaged(build.digest_of("double"), build.SUFFIX if target is None else target.suffix)
        for other in library.parent.glob("_core-*"):
            other.unlink()
        build.compile_library(command, library, is_windows=library.suffix == ".dll")
        build_data["pure_python"] = False
        build_data["artifacts"].append(f"edmctl/core/{library.name}")
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"py3-none-{platform if target is None else target.tag}"


sys.path.insert(0, str(Path(__file__).parent))
