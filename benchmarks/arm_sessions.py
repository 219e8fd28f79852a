"""Compare the golden digests with those of an emulated aarch64 computer: its Python, its numpy and our library.

    python benchmarks/arm_sessions.py FOLDER [--sample]

Needs Debian with qemu-user, and ziglang. FOLDER receives Debian's Python for arm64 and wheels of the versions that
are installed here, 200 MB; nothing is installed on this computer. Takes some minutes. The exit code is 1 where a
digest is not the recorded one (tests/simulator/golden_core.json), 2 without these programs.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import shutil
import subprocess
import sys
from pathlib import Path

from edmctl.core import build
from tools.wheels import TARGETS

ROOT = Path(__file__).resolve().parents[1]
DEBIAN = ("python3.11-minimal", "libpython3.11-stdlib", "libc6", "libgcc-s1", "libstdc++6")
WHEELS = {name: importlib.metadata.version(name) for name in ("numpy", "platformdirs")}
PLATFORMS = ("manylinux2014_aarch64", "manylinux_2_27_aarch64", "manylinux_2_28_aarch64")


def run(*command: str | Path) -> None:
    """Run a command to its end."""
    subprocess.run([str(word) for word in command], check=True)


def python_for_arm(folder: Path) -> Path:
    """Unpack Debian's Python for arm64 into a folder; return that folder."""
    root, state, kept = folder / "root", folder / "apt/state", folder / "apt/cache"
    if root.is_dir():
        return root
    for place in (root, state / "lists/partial", kept / "archives/partial"):
        place.mkdir(parents=True)
    (state / "status").touch()
    settings = {
        "APT::Architecture": "arm64",
        "APT::Architectures": "arm64",
        "Dir::State": state,
        "Dir::State::status": state / "status",
        "Dir::Cache": kept,
    }
    apt = ["apt-get", "-q", *(word for name, value in settings.items() for word in ("-o", f"{name}={value}"))]
    run(*apt, "update")
    run(*apt, "install", "-y", "--no-install-recommends", "--download-only", *DEBIAN)
    for package in sorted((kept / "archives").glob("*.deb")):
        run("dpkg-deb", "-x", package, root)
    return root


def wheels_for_arm(folder: Path) -> Path:
    """Install wheels for aarch64 into a folder; return that folder."""
    site = folder / "site"
    if not site.is_dir():
        platforms = [word for name in PLATFORMS for word in ("--platform", name)]
        versions = [f"{name}=={version}" for name, version in WHEELS.items()]
        options = ["--only-binary=:all:", "--python-version", "3.11", "--implementation", "cp", "-q"]
        pip = [sys.executable, "-m", "pip", "install", *platforms, *options, "--target", str(site)]
        run(*pip, *versions, "cobs")
    return site


def main() -> int:
    """Set up what is missing, and compare; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sample", action="store_true")
    arguments = parser.parse_args()
    for program in ("qemu-aarch64", "apt-get", "dpkg-deb"):
        if shutil.which(program) is None:
            print(f"there is no {program}; nothing was compared")
            return 2
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    root, site, library = python_for_arm(folder), wheels_for_arm(folder), folder / "library.so"
    build.compile_library(TARGETS["linux-aarch64"].command, library)
    check = ["-m", "tests.simulator.golden_core", "--check", "--library", str(library)]
    environ = {"PYTHONPATH": f"{site}:{ROOT}", "HOME": str(folder), "PATH": os.defpath}
    done = subprocess.run(
        [
            "qemu-aarch64",
            "-L",
            root,
            root / "usr/bin/python3.11",
            "-B",
            *check,
            *["--sample"] * arguments.sample,
        ],
        cwd=ROOT,
        env=environ,
        check=False,
    )
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
