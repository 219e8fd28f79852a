"""Stands for pyocd, openocd, st-flash, st-info and dfu-util, by the name that it is started under.

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


def st_info(arguments: list[str]) -> int:
    assert arguments == ["--probe"]
    if chip() is None:
        print("Found 0 stlink programmers")
        return 0
    serials = ["066DFF485550755187123543", "0671FF343056363043090732"][: 2 if trouble() == "several" else 1]
    print(f"Found {len(serials)} stlink programmers")
    for serial in serials:
        print(f"  version:    V2J37S26\n  serial:     {serial}\n  flash:      2097152 (pagesize: 16384)")
        print("  sram:       262144")
        print(
            f"  chipid:     0x{0 if trouble() == 'no chip' else (chip() or 0) & 0xFFF:04x}\n  descr:      F42x/F43x"
        )
    return 0


def st_flash(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--serial")
    parser.add_argument("--connect-under-reset", action="store_true")
    parser.add_argument("command", choices=("write", "read", "reset"))
    parser.add_argument("rest", nargs="*")
    asked = parser.parse_args(arguments)
    print("st-flash 1.7.0")
    if chip() is None:
        print("2026-01-01T00:00:00 WARN usb.c: Couldn't find any ST-Link devices", file=sys.stderr)
        return 255
    if asked.command == "write":
        assert asked.connect_under_reset, "its watchdog resets a chip that is only halted"
        if trouble() == "write":
            print(
                "2026-01-01T00:00:00 ERROR common.c: stlink_flash_loader_run(0x8000000) failed! == -1",
                file=sys.stderr,
            )
            return 255
        write(*asked.rest)
        print("2026-01-01T00:00:00 INFO common.c: Flash written and verified! jolly good!", file=sys.stderr)
    elif asked.command == "read":
        assert asked.connect_under_reset
        read(*asked.rest)
    else:
        start()
    return 0


def dfu_util(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("-d")
    parser.add_argument("-a")
    parser.add_argument("-S")
    parser.add_argument("-s")
    parser.add_argument("-l", action="store_true")
    parser.add_argument("-D")
    parser.add_argument("-U")
    asked = parser.parse_args(arguments)
    print("dfu-util 0.11\n")
    banks = {0x20036419: 2, 0x10076413: 1}.get(chip() or 0, 0)
    flash = "@Internal Flash  /0x08000000/" + ",".join(["04*016Kg,01*064Kg,07*128Kg"] * banks)
    if asked.l:
        for alt, name in enumerate((flash, "@Option Bytes  /0x1FFFC000/01*016 e") if banks else ()):
            device = f'ver=2200, devnum=8, cfg=1, intf=0, path="1-2", alt={alt}'
            print(f'Found DFU: [0483:df11] {device}, name="{name}", serial="337233573236"')
        return 0
    if chip() is None:
        print("dfu-util: No DFU capable USB device available", file=sys.stderr)
        return 74
    place = (asked.s or "").split(":")
    if asked.D:
        if trouble() == "write":
            print("dfu-util: Error during download", file=sys.stderr)
            return 74
        write(asked.D, place[0])
    if asked.U:
        assert not Path(asked.U).exists(), "dfu-util overwrites nothing"
        read(asked.U, place[0], place[1])
    if "leave" in place:
        start()
    return 0


if __name__ == "__main__":
    with (BOARD / "log").open("a") as log:
        log.write(" ".join([NAME, *sys.argv[1:]]) + "\n")
    kinds = {
        "pyocd": pyocd,
        "openocd": openocd,
        "st-info": st_info,
        "st-flash": st_flash,
        "dfu-util": dfu_util,
    }
    sys.exit(kinds[re.sub(r"\.py$", "", NAME)](sys.argv[1:]))
