"""The one door to numba: strict arithmetic, code kept on disk, and no SciPy at start-up.

The first function that numba compiles or loads makes it ask for SciPy's BLAS, which no loop of this project
calls; importing `scipy.linalg` for that answer takes 0.2 s of every process. Here the answer is "not there".
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

_F = TypeVar("_F", bound="Callable[..., Any]")
_BLAS = "scipy.linalg"


def _load_numba() -> ModuleType:
    if _BLAS in sys.modules:
        import numba

        return numba
    sys.modules[_BLAS] = None  # type: ignore[assignment]
    try:
        import numba
        import numba.np.arraymath  # asks for BLAS once, while it is loaded
    finally:
        del sys.modules[_BLAS]
    return numba


_numba = _load_numba()


def compiled(function: _F) -> _F:
    """Compile a part of a cached function; frees the GIL, no fastmath, so that plain Python gives the same bits."""
    return cast("_F", _numba.njit(nogil=True, error_model="numpy")(function))


def cached(function: _F) -> _F:
    """Compile at the first call like `compiled`, and keep the code on disk beside its file."""
    return cast("_F", _numba.njit(cache=True, nogil=True, error_model="numpy")(function))
