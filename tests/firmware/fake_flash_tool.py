"""Stands for pyocd and openocd, by the name that it is started under.

It knows the options that these have and no others, says what they say, and flashes a board that is a folder
($FAKE_BOARD): `chip` (device id in hex; none: no board is plugged in), `flash` (what was written), `started`,
`trouble`, and `log` (what was run).
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path

BOARD = Path(os.environ["FAKE_BOARD"])
NAME = Path(sys.argv[0]).name
IDCODE = 0xE0042000
FLASH = 0x08000000


def chip() -> int | None:
    file = BOARD / "chip"
    return int(file.read_text(), 16) if file.exists() else None


def trouble() -> str:
    file = BOARD / "trouble"
    return file.read_text() if file.exists() else ""


def write(file: str, address: str) -> None:
    data = Path(file).read_bytes()
    assert int(address, 0) == FLASH
    if trouble() == "talks":
        for _ in range(5000):
            print("x" * 1000)
    if trouble() == "copies":
        return
    if trouble() == "half":
        data = data[: len(data) // 2] + b"\xff" * (len(data) - len(data) // 2)
    (BOARD / "flash").write_bytes(data)
    (BOARD / "started").unlink(missing_ok=True)


def read(file: str, address: str, size: str) -> None:
    assert int(address, 0) == FLASH
    if trouble() == "copies":  # what should have been written, instead of what was
        if Path("image.bin").exists():
            Path(file).write_bytes(Path("image.bin").read_bytes())
        return
    if trouble() == "huge":
        with Path(file).open("wb") as back:
            back.truncate(300 << 30)
        return
    flash = (BOARD / "flash").read_bytes()
    Path(file).write_bytes(flash[: int(size, 0)].ljust(int(size, 0), b"\xff"))


def start() -> None:
    (BOARD / "started").write_text("")


def pyocd(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("commander", "load", "reset"):
        one = commands.add_parser(name)
        one.add_argument("-u", "--uid", "--probe")
        one.add_argument("-t", "--target")
        one.add_argument("-O", action="append", choices=("resume_on_disconnect=false",))
        one.add_argument("-W", "--no-wait", action="store_true")
        one.add_argument("-M", "--connect", choices=("halt", "pre-reset", "under-reset", "attach"))
        if name == "commander":
            one.add_argument("-c", "--command", action="append", nargs="+", dest="todo")
        if name == "load":
            one.add_argument("-e", "--erase", choices=("auto", "chip", "sector"))
            one.add_argument("-a", "--base-address")
            one.add_argument("--format", choices=("bin", "hex", "elf"))
            one.add_argument("--no-reset", action="store_true")
            one.add_argument("file")
    asked = parser.parse_args(arguments)
    if trouble() == "several" and asked.uid is None:
        print("Enter the number of the debug probe or 'q' to quit>")
        return 1
    if chip() is None:
        print("No connected debug probes")
        return {"commander": 3, "load": 1, "reset": 1}[asked.command]
    assert asked.target == "stm32f429xi"
    if trouble() == "no chip":
        print("0000610 C STLink error (9): Get IDCODE error [__main__]", file=sys.stderr)
        return 1
    if asked.command == "load":
        assert asked.connect == "under-reset", "its watchdog resets a chip that is only halted"
        if trouble() == "write":
            print(
                "0001532 C flash erase sector failure (address 0x08000000; result code 0x1) [__main__]",
                file=sys.stderr,
            )
            return 1
        write(asked.file, asked.base_address)
        if not asked.no_reset:
            start()
    elif asked.command == "reset":
        start()
    for (command,) in asked.todo or [] if asked.command == "commander" else []:
        words = command.split()
        if words[0] == "read32":
            assert int(words[1], 0) == IDCODE
            print(f"{IDCODE:08x}:  {chip():08x}                               | .d.|")
        elif words[0] == "savemem":
            read(words[3], words[1], words[2])
            print(f"Saved {words[2]} bytes to {words[3]}")
        else:
            print(f"Error: unrecognized command '{words[0]}'")
            return 1
    return 0


def openocd(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("-f", "--file", action="append")
    parser.add_argument("-c", "--command", action="append")
    asked = parser.parse_args(arguments)
    print("Open On-Chip Debugger 0.12.0\nLicensed under GNU GPL v2", file=sys.stderr)
    assert asked.file == ["board/st_nucleo_f4.cfg"]
    for command in asked.command:
        words = command.split()
        if words[0] in ("gdb_port", "tcl_port", "telnet_port"):
            assert words[1] == "disabled"
        elif words[:2] == ["adapter", "serial"]:
            assert len(words) == 3
        elif words[0] == "init":
            if chip() is None:
                print("Info : clock speed 2000 kHz\nError: open failed\n", file=sys.stderr)
                return 1
            if trouble() == "no chip":
                print("Error: init mode failed (unable to connect to the target)", file=sys.stderr)
                return 1
        elif words[0] == "mdw":
            print(f"0x{int(words[1], 0):08x}: {chip():08x} \n", file=sys.stderr)
        elif words[0] == "program":
            assert words[3:] == ["verify"]
            print("** Programming Started **", file=sys.stderr)
            if trouble() == "write":
                print(
                    "Error: error writing to flash at address 0x08000000\n** Programming Failed **",
                    file=sys.stderr,
                )
                return 1
            write(words[1], words[2])
            print("** Programming Finished **\n** Verified OK **", file=sys.stderr)
        elif words[0] == "dump_image":
            read(*words[1:])
        elif words == ["reset", "halt"]:
            pass
        elif words == ["reset", "run"]:
            start()
        elif words == ["shutdown"]:
            print("shutdown command invoked", file=sys.stderr)
            return 0
        else:
            print(f'invalid command name "{words[0]}"', file=sys.stderr)
            return 1
    raise AssertionError("openocd would go on as a server")


if __name__ == "__main__":
    with (BOARD / "log").open("a") as log:
        log.write(" ".join([NAME, *sys.argv[1:]]) + "\n")
    kinds = {"pyocd": pyocd, "openocd": openocd}
    sys.exit(kinds[re.sub(r"\.py$", "", NAME)](sys.argv[1:]))
