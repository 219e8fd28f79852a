"""List the fields of results that differ on another processor.

    python benchmarks/processors.py

Each command runs as this processor is, and as one without AVX and fused multiply-add, as far as numpy, OpenBLAS and
the C library can be told so: a job, a calibration, plans of shipped studies, a study and its report. Compared are
the JSON objects of --json and all that is in run and calibration files, but times of day, durations of the host and
paths. On x86-64 with glibc only. What is promised is in CONTRIBUTING.md.
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

OTHER = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 X86_V3",
    "OPENBLAS_CORETYPE": "Prescott",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA",
}
STUDIES = ("fastest-clean-hole", "response-surface", "taguchi-l9")
HOST = re.compile(
    "run_file|run_id|files|wall|folder|path|command|_time$|@start|utc|sha256|process_id|host", re.I
)
"""Names of what differs in every run."""

Values = dict[str, Any]


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the name and value of every leaf of a JSON object."""
    pairs = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    )
    if pairs is None:
        yield name, value
        return
    for key, one in pairs:
        yield from flat(one, f"{name}.{key}" if name else str(key))


def said(environ: dict[str, str], folder: Path, *words: str) -> Values:
    """Return the JSON object of a command, flat."""
    command = [sys.executable, "-m", "edmctl", *words, "--json"]
    done = subprocess.run(command, cwd=folder, env=environ, capture_output=True, text=True, check=False)
    if not done.stdout:
        raise RuntimeError(done.stderr)
    return dict(flat(json.loads(done.stdout)))


def stored(file: Path) -> Values:
    """Return datasets and attributes of a run file by their names."""
    values: Values = {}

    def take(name: str, item: Any) -> None:
        values.update((f"{name}@{key}", str(value)) for key, value in item.attrs.items())
        if isinstance(item, h5py.Dataset):
            content = item[()]
            if content.dtype.names:
                values.update((f"{name}.{field}", content[field]) for field in content.dtype.names)
            elif name == "entry/summary":
                values.update(flat(json.loads(bytes(content)), "entry/summary"))
            else:
                values[name] = content

    with h5py.File(file) as run:
        run.visititems(take)
    return values


def results(other: dict[str, str]) -> dict[str, Values]:
    """Return the values of each command on a processor."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        environ = {**os.environ, **other, "XDG_DATA_HOME": name, "XDG_CONFIG_HOME": name}
        depth = ("--set", "target.depth_um=10", "--seed", "1")
        found = {"machine": said(environ, folder, "machine", "--profile", "cu270", *depth, "--out", "runs")}
        found["run file of machine"] = stored(next((folder / "runs").glob("*.h5")))
        found["calibrate"] = said(environ, folder, "calibrate", "--seed", "1", "--output", "c.toml")
        found["calibration file"] = dict(flat(tomllib.loads((folder / "c.toml").read_text(encoding="utf-8"))))
        for study in STUDIES:
            found[f"study plan {study}"] = said(environ, folder, "study", "plan", study)
        found["study run taguchi-l9"] = said(environ, folder, "study", "run", "taguchi-l9", "--out", "study")
        found["study report"] = said(environ, folder, "study", "report", "study")
        return found


def is_same(a: Any, b: Any) -> bool:
    """Whether values are the same to the bit; NaN is NaN."""
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes())
    return bool(a == b) or (isinstance(a, float) and math.isnan(a) and math.isnan(b))


def difference(a: Any, b: Any) -> float:
    """Return the greatest relative difference of numbers; infinite where they are none."""
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape or a.dtype.kind not in "fiu":
        return math.inf
    a, b = a.astype(float), b.astype(float)
    return float(np.nanmax(np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-300)))


def main() -> int:
    """Run everything on both processors, and print what differs."""
    here, there = results({}), results(OTHER)
    for command, values in here.items():
        others = there[command]
        names = sorted(name for name in values.keys() | others.keys() if not HOST.search(name))
        differing = [name for name in names if not is_same(values.get(name), others.get(name))]
        print(f"{command}: {len(differing)} of {len(names)} fields differ")
        groups: dict[str, list[float]] = {}
        for name in differing:
            series = groups.setdefault(re.sub(r"\.\d+", ".*", name), [])
            series.append(difference(values.get(name), others.get(name)))
        for group, most in groups.items():
            print(f"    {group}: {len(most)}, at most {max(most):.1e} relative")
    return 0


if __name__ == "__main__":
    sys.exit(main())
