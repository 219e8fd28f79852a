"""Controller for a micro-EDM machine whose tool hangs on an amplified piezo actuator.

The names below are loaded when they are used; `edmctl.api` tells of them.
"""

from edmctl.version import __version__

TYPE_CHECKING = False  # importing `typing` takes as long as all the rest of a start
if TYPE_CHECKING:
    from edmctl.api import (
        Machine,
        StopRequest,
        calibrate_files,
        connect,
        forecast,
        load_profile,
        open_run,
        simulate,
    )
    from edmctl.study.study import Study

__all__ = [
    "Machine",
    "StopRequest",
    "Study",
    "__version__",
    "calibrate_files",
    "connect",
    "forecast",
    "load_profile",
    "open_run",
    "simulate",
]


def __getattr__(name: str) -> object:
    if name == "errors":
        from importlib import import_module

        return import_module("edmctl.errors")
    if name not in __all__:
        raise AttributeError(f"module 'edmctl' has no attribute {name!r}")
    if name == "Study":  # needs what no single job does
        from edmctl.study.study import Study

        return Study
    from edmctl import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "errors"})
