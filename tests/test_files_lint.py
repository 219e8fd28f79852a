"""Every file that edmctl reads is opened by `edmctl.files`: only regular files, without waiting, with a size cap."""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "edmctl"
READS = {"read_text", "read_bytes", "fdopen"}
LOADERS = {
    "tomllib.load",
    "json.load",
    "pickle.load",
    "np.load",
    "np.loadtxt",
    "np.genfromtxt",
    "np.fromfile",
    "np.memmap",
    "h5py.File",
    "h5f.open",
    "os.open",
    "io.open",
    "mmap.mmap",
    "shutil.copyfile",
    "shutil.copy",
}
METHODS = {"open", *READS, *(name.rpartition(".")[2] for name in LOADERS)}
OPENED = "its beginning was read by files.open_regular"
SOURCE = "sources of the program, or what was built of them"
OWN = "made by this process a moment ago"
ALLOWED = {
    "files.py": "the place",
    "board/board_build.py: build_board": OWN,
    "core/build.py: source_version": SOURCE,
    "core/build.py: digest_of": SOURCE,
    "board/settings.py: settings_of": SOURCE,
    "jobs/doctor.py: line_settings": "/sys",
    "link/compatibility.py: own_schema": "a file of the package",
    "link/serial_line.py: open_port": "a serial port",
    "process/erosion.py: materials": "a file of the package",
    "record/recovery.py: _recover_damaged_here": OPENED,
    "record/delimited.py: _plain_numbers": "lines of a text",
    "record/opening.py: open_hdf5": OPENED,
    "record/opening.py: open_swmr": OPENED,
    "record/opening.py: append_checksum": OWN,
    "record/opening.py: end_at_breaks": OWN,
    "board/emulated.py: image": SOURCE,
    "board/first_start/checklist.py": "a file of the package",
    "simulator/serve.py: _hold": "the other end of a pseudo-terminal that this process has made",
}
"""File, or file and function, that opens files itself, and why it may."""
HARMLESS = ("os.devnull", "__file__", "'/proc/", "os.O_EXCL", "file.fileno()", "driver='core'")
"""Words of a call that opens nothing that a user or a folder names."""


def opens(call: ast.Call) -> bool:
    """Whether a call opens or reads a file, as far as its text tells."""
    method = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if method not in METHODS:
        return False
    name = ast.unparse(call.func)
    if name == "open" or name in LOADERS or ("." in name and method in READS):
        return True
    if method != "open" or "." not in name:
        return False
    given = [*call.args, *(word.value for word in call.keywords if word.arg == "mode")]
    modes = [one.value for one in given if isinstance(one, ast.Constant) and isinstance(one.value, str)]
    return not call.args or any(not set(mode) & set("wxa") or "+" in mode for mode in modes)


def calls(tree: ast.AST, function: str = "") -> list[tuple[str, ast.Call]]:
    """Every call with the function that it is in."""
    found = []
    for node in ast.iter_child_nodes(tree):
        own = node.name if isinstance(node, ast.FunctionDef) else function
        if isinstance(node, ast.Call):
            found.append((own, node))
        found += calls(node, own)
    return found


def test_files_are_opened_in_one_place() -> None:
    found: dict[str, list[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        file = path.relative_to(PACKAGE).as_posix()
        for function, call in calls(ast.parse(path.read_text(encoding="utf-8"))):
            if opens(call) and not any(word in ast.unparse(call) for word in HARMLESS):
                place = file if file in ALLOWED else f"{file}: {function}"
                found.setdefault(place, []).append(f"{call.lineno}: {ast.unparse(call)[:80]}")
    assert {place: lines for place, lines in found.items() if place not in ALLOWED} == {}
    assert set(ALLOWED) <= set(found), "no longer needed"
