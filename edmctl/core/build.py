"""Finds or builds the compiled library: controller, virtual machine and operators in C (firmware/).

A wheel contains the library for its platform. In a source tree whose C sources have changed since then it is built
again into the user's cache, in seconds, with the C compiler of the system or that of the package ziglang. The name
of a library contains a digest of its sources and flags. Beside it is its hash (LIBRARY.sha256): one without, or with
another hash, is not used, because a damaged library would kill the process.

The build hook (hatch_build.py) imports this module, which needs nothing but the standard library.
"""

from __future__ import annotations

import errno
import hashlib
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import PreconditionError, installing
from edmctl.files import RECORD_BYTES, path_variable, read_bytes, sync

CACHE_VARIABLE = "EDMCTL_FIRMWARE_CACHE"
ZIG_CACHE_VARIABLE = "ZIG_GLOBAL_CACHE_DIR"
REALS = ("double", "float")
"""Arithmetic of the controller in a build: float is that of a board. The virtual machine is always in double."""
PARTS = ("core", "gen", "host", "math", "plant", "operators")
"""Folders of the sources."""

ZIG = (sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline")
"""Without the last word it builds for this very processor; another one may share the folder of the library."""
_COMPILERS = ("cc", "gcc", "clang")
_FLAGS: tuple[str, ...] = (
    "-std=c11",
    "-O3",
    "-fno-fast-math",  # behind CC's own words, as the next one
    "-fno-unsafe-math-optimizations",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fPIC",
    "-shared",
    "-fvisibility=hidden",
    "-fno-semantic-interposition",
)
"""None changes a result: -fno-trapping-math lets both sides of a choice be calculated, no other sums."""
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
_WHOLE = "-flto"
"""Of a tick of 0.4 µs calls between files are a tenth; a compiler that cannot look across them does without."""
LINGER_TICKS = 200
"""Telemetry of a virtual machine is sent so often at least, in ms."""
_SECONDS = 600


@dataclass(frozen=True, slots=True)
class Build:
    """A library that was built, and what by.

    real : its arithmetic, one of REALS. sources : digest of what it was built from.
    compiler : command and first line of its version. is_new : it was built now.
    """

    path: Path
    real: str
    sources: str
    compiler: str
    is_new: bool


def source_folder() -> Path:
    """Return the folder of the firmware's sources: inside an installed package, beside it in a source tree."""
    package = Path(__file__).resolve().parent
    installed = package / "source"
    return installed if installed.is_dir() else package.parent.parent / "firmware"


def source_version() -> tuple[int, int, int]:
    """Return the version of the firmware that this program builds. Raises OSError, ValueError without sources."""
    text = (source_folder() / "core" / "version.h").read_text(encoding="utf-8")
    numbers = dict(re.findall(r"^#define FW_(MAJOR|MINOR|PATCH) (\d+)$", text, flags=re.MULTILINE))
    if len(numbers) < 3:
        raise ValueError("version.h names no version")
    return int(numbers["MAJOR"]), int(numbers["MINOR"]), int(numbers["PATCH"])


def digest_of(real: str) -> str:
    """Return the digest of the sources and flags of a library. Raises PreconditionError E8094 without sources."""
    folder = source_folder()
    content = hashlib.sha256(repr([*_FLAGS, *_defines(real)]).encode())
    sources = [path for part in PARTS for path in files_in(folder / part, "*.[ch]")]
    try:
        if not sources:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder))
        for path in (*sources, *files_in(folder, "*.h")):
            content.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    except OSError as error:
        raise failures.sources_missing(
            filename=error.filename, reason=error.strerror, install=installing("--force-reinstall", "edmctl")
        ) from error
    return content.hexdigest()[:16]


def files_in(folder: Path, pattern: str) -> list[Path]:
    """Return the regular files of a folder in their order, without hidden ones such as the locks of an editor."""
    return [path for path in sorted(folder.glob(pattern)) if path.is_file() and path.name[0] != "."]


def packaged(digest: str, suffix: str = SUFFIX) -> Path:
    """Return where the library of a wheel is, or would be."""
    return Path(__file__).with_name(f"_core-{digest}{suffix}")


def hash_file(library: Path) -> Path:
    """Return the file beside a library with its hash."""
    return library.with_name(f"{library.name}.sha256")


def is_whole(library: Path) -> bool:
    """Return whether the library is there and has the hash that its build has left beside it."""
    try:
        return read_bytes(hash_file(library)) == _hash_line(library, read_bytes(library, RECORD_BYTES))
    except OSError:
        return False


def _hash_line(library: Path, content: bytes) -> bytes:
    """Return the hash of a library as `sha256sum` writes it."""
    return f"{hashlib.sha256(content).hexdigest()}  {library.name}\n".encode()


def found(real: str = "double") -> Build:
    """Return the library of that arithmetic: the packaged one, else one that is built. Raises as `built` does."""
    digest = digest_of(real)
    library = packaged(digest)
    return Build(library, real, digest, "the package", is_new=False) if is_whole(library) else built(real)


def built(real: str = "double", environ: Mapping[str, str] = os.environ, *, anew: bool = False) -> Build:
    """Return a library in the cache, built by CC or the compiler that there is if it is not there, or `anew`.

    Raises PreconditionError: E8093 without a C compiler, E8094 where it cannot build the library.
    """
    digest = digest_of(real)
    command = compiler(environ.get("CC", ""))
    version = version_of(command)
    maker = hashlib.sha256(repr((command, version)).encode()).hexdigest()[:8]
    library = cache_folder(environ) / f"edmlink-{real}-{digest}-{maker}{SUFFIX}"
    said = f"{shlex.join(command)} ({version})"
    if not anew and is_whole(library):
        return Build(library, real, digest, said, is_new=False)
    if sys.stderr is not None:
        sys.stderr.write(f"building the controller and the virtual machine from {source_folder()}\n")
    compile_library(command, library, real)
    return Build(library, real, digest, said, is_new=True)


def compile_library(command: Sequence[str], library: Path, real: str = "double") -> None:
    """Compile all sources into a shared library, with its hash beside it. Raises PreconditionError E8094."""
    folder = source_folder()
    sources = [str(path) for part in PARTS for path in files_in(folder / part, "*.c")]
    includes = [f"-I{folder / part}" for part in PARTS]
    arguments = [*_FLAGS, *_defines(real), f'-DEDM_SOURCES="{digest_of(real)}"', *includes, *sources]
    try:
        _compile([*command, _WHOLE, *arguments], library)
    except PreconditionError:
        _compile([*command, *arguments], library)


def _defines(real: str) -> list[str]:
    if real not in REALS:
        raise ValueError(f"the firmware calculates in {' or '.join(REALS)}, not in {real}")
    kind = ["-DEDM_REAL_DOUBLE"] if real == "double" else []
    return [*kind, f"-DEDM_LINGER_TICKS={LINGER_TICKS}", "-DEDM_BOX_LASTS=0", "-DEDM_OFF_NS_MIN=0"]


def cache_folder(environ: Mapping[str, str]) -> Path:
    if named := path_variable(CACHE_VARIABLE, environ):
        return named
    import platformdirs

    return platformdirs.user_cache_path("edmctl", appauthor=False) / "firmware"


def system_compiler() -> str | None:
    """Return the path of the system's C compiler; None without one."""
    return next((path for name in _COMPILERS if (path := shutil.which(name))), None)


@cache
def compiler(named: str = "") -> tuple[str, ...]:
    """Command of a C compiler: $CC, else one of the system's, else that of the package ziglang."""
    if named.strip():
        try:
            return tuple(shlex.split(named))
        except ValueError as error:
            raise failures.compiler_unusable(command=named, error=error) from error
    if found := system_compiler():
        return (found,)
    if importlib.util.find_spec("ziglang") is not None:
        return ZIG
    raise failures.no_compiler(install=installing("ziglang"))


@cache
def version_of(command: tuple[str, ...]) -> str:
    """Return the first line of a compiler's version. Raises PreconditionError E8093."""
    try:
        return next(iter(run_compiler([*command, "--version"]).splitlines()), "").strip()
    except CompilerFailed as error:
        raise failures.compiler_unusable(command=shlex.join(command), error=error) from error


class CompilerFailed(Exception):
    """A compiler does not run or does not compile; the text is the beginning of its output, or how it ended."""


def run_compiler(command: Sequence[str]) -> str:
    """Run a compiler and return its output; zig keeps its library beside ours. Raises CompilerFailed."""
    zig_cache = os.environ.get(ZIG_CACHE_VARIABLE) or str(cache_folder(os.environ) / "zig")
    try:
        done = subprocess.run(
            command,
            env={**os.environ, ZIG_CACHE_VARIABLE: zig_cache},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_SECONDS,
            check=False,
        )
    except OSError as error:
        raise CompilerFailed(error.strerror or str(error)) from error
    except subprocess.TimeoutExpired as error:
        raise CompilerFailed(f"it is not done after {_SECONDS} s") from error
    code = done.returncode
    if code:
        ending = f"it ends with exit code {code}" if code > 0 else f"it was killed by signal {-code}"
        raise CompilerFailed("\n".join(done.stderr.splitlines()[:10]).strip() or ending)
    return done.stdout


def _compile(command: list[str], library: Path) -> None:
    """Build beside the place of the library and move it there: whoever loads it finds a whole one or none."""
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        for folder in library.parent.glob("building-*"):
            with suppress(OSError):
                if folder.stat().st_mtime < time.time() - 3600.0:  # its process died
                    shutil.rmtree(folder, ignore_errors=True)
        building = tempfile.TemporaryDirectory(dir=library.parent, prefix="building-")
    except OSError as error:
        raise failures.library_not_kept(
            parent=library.parent, reason=error.strerror, cache_variable=CACHE_VARIABLE
        ) from error
    try:
        with building as work:
            made = Path(work) / library.name
            run_compiler([*command, "-o", str(made)])
            if not made.is_file():
                raise CompilerFailed(f"{shlex.join(command[:1])} made no library")
            hash_file(made).write_bytes(_hash_line(library, read_bytes(made, RECORD_BYTES)))
            for file in (made, hash_file(made)):
                with suppress(OSError):  # a system that syncs no file that is open for reading
                    sync(file)
            with suppress(FileExistsError, PermissionError):  # on Windows, another process uses the one there
                made.replace(library)
                hash_file(made).replace(hash_file(library))
    except (OSError, CompilerFailed) as error:
        raise failed(f"{getattr(error, 'strerror', None) or error}.") from error


def failed(reason: str) -> PreconditionError:
    """Return the error E8094 of a library that cannot be built or loaded."""
    return failures.library_not_built(reason=reason, cache_variable=CACHE_VARIABLE)
