"""The core reads and writes every golden frame, byte for byte, in a program of its codec and their fields."""

from __future__ import annotations

import json
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest

from edmctl.core.build import compiler, source_folder
from tools.generate.schema import Field, Layout, load_schema

GOLDEN = Path(__file__).parents[1] / "link" / "golden"
HEAD = """\
#include <stdio.h>
#include "core.h"

static void show(const uint8_t *bytes, size_t size) {
    for (size_t i = 0; i < size; i++) printf("%02x", bytes[i]);
    printf("\\n");
}

int main(void) {
    uint8_t payload[MAX_PAYLOAD], frame[FRAME_MOST];
    (void)frame;
"""


def literal(field: Field, value: Any) -> str:
    if field.type == "s12":
        return json.dumps(value)
    return f"{value!r}" if field.divisor != 1 else f"{value}{'ull' if field.type == 'u64' else 'll'}"


def initialised(layout: Layout, values: dict[str, Any]) -> str:
    return ", ".join(f".{f.name} = {literal(f, values[f.name])}" for f in layout.fields)


def writing(name: str, layout: Layout, golden: dict[str, Any]) -> str:
    """C that writes a golden frame of a reply, or of a message sent unasked."""
    low, lines, size = name.lower(), [], f"{layout.size}"
    if layout.fields:
        lines.append(f"const struct {low} m = {{{initialised(layout, golden['fields'])}}};")
        lines.append(f"{low}_write(payload, &m);")
    if layout.record_size == 1:
        data = ", ".join(str(record["data"]) for record in golden["records"])
        lines.append(
            f"const uint8_t records[] = {{{data}}}; memcpy(payload + {size}, records, sizeof records);"
        )
        size += f" + {len(golden['records'])}"
    elif layout.record:
        for at, record in enumerate(golden["records"]):
            wires = {f.name: round(record[f.name] * f.divisor) for f in layout.record}
            fields = ", ".join(f".{key} = {value}" for key, value in wires.items())
            lines.append(f"const struct {low}_record r{at} = {{{fields}}};")
            lines.append(f"{low}_record_write(payload + {layout.size + at * layout.record_size}, &r{at});")
        size += f" + {len(golden['records']) * layout.record_size}"
    header = f"0x{golden['type']}, {golden['seq']}, 0x{golden['session']}, {golden['flags']}"
    return f"    {{ {' '.join(lines)} show(frame, frame_encode(frame, {header}, payload, {size})); }}\n"


def reading(name: str, layout: Layout, golden: dict[str, Any]) -> str:
    """C that takes a golden frame of a command and tells 1 where every field is what it should be."""
    data = ", ".join(f"0x{byte:02x}" for byte in bytes.fromhex(golden["frame"]))
    header = [
        f"f.type == 0x{golden['type']}",
        f"f.seq == {golden['seq']}",
        f"f.session == 0x{golden['session']}",
    ]
    header.append(f"f.size == {layout.size} && edm_request_size(f.type) == {layout.size}")
    header += [f"m.{f.name} == {literal(f, golden['fields'][f.name])}" for f in layout.fields]
    read = f"struct {name.lower()} m; {name.lower()}_read(&m, f.payload);" if layout.fields else ""
    return (
        f"    {{ const uint8_t bytes[] = {{{data}}}; size_t n = sizeof bytes, found = 0;\n"
        f"      struct edm_receiver r = {{0}}; struct edm_frame f;\n"
        f"      for (size_t i = 0; i < n; i++) {{\n"
        f"        i += frame_fill(&r, bytes + i, n - i);\n"
        f"        if (i < n && frame_end(&r, &f)) found = i + 1 == n; }}\n"
        f'      if (!found) {{ printf("none\\n"); }} else {{ {read} printf("%d\\n", {" && ".join(header)}); }} }}\n'
    )


def golden_of(name: str) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    return loaded


def test_the_codec_makes_and_reads_every_golden_frame(tmp_path: Path) -> None:
    schema = load_schema()
    commands = {m.name for m in schema.messages if m.request is not None}
    source, expected = HEAD, []
    for name, layout in schema.layouts():
        if name == "LOG":  # the core has nothing to say to people
            continue
        golden = golden_of(name)
        if name in commands:
            source += reading(name, layout, golden)
            expected.append((name, "1"))
        else:
            source += writing(name, layout, golden)
            expected.append((name, golden["frame"]))
    program, text = tmp_path / "golden", tmp_path / "golden.c"
    text.write_text(source + "    return 0;\n}\n", encoding="utf-8")
    folder = source_folder()
    parts = [folder / "core" / "frame.c", folder / "gen" / "edmlink.c"]
    flags = ["-std=c11", "-DEDM_REAL_DOUBLE", "-w", f"-I{folder / 'core'}", f"-I{folder / 'gen'}"]
    command = [*compiler(), *flags, "-o", str(program), str(text), *map(str, parts)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.fail(f"{shlex.join(command)}\n{done.stderr}")
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
    assert list(zip((name for name, _ in expected), said, strict=True)) == expected
