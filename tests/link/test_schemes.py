"""Every URL scheme of pyserial: a line carries bytes both ways, a held device is refused, the page lists it."""

from __future__ import annotations

import os
import queue
import socket
import sys
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from time import monotonic
from types import ModuleType

import pytest
import serial.tools.list_ports
import serial.urlhandler

from edmctl.errors import LinkLost
from edmctl.link.opening import open_line
from edmctl.link.serial_line import SCHEMES
from tests.serving import bridged

PATIENCE_S = 10.0
ON_DEVICES = ("", "alt", "hwgrep", "spy")
PAGE = Path(__file__).parents[2] / "docs" / "serial-port.md"

pytestmark = pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")


@contextmanager
def echoing_pty() -> Iterator[str]:
    """Yield a pty that returns what it gets."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    tty.setraw(ours)

    def echo() -> None:
        while (data := os.read(ours, 4096)) != b"end":
            os.write(ours, data)

    thread = threading.Thread(target=echo)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        os.write(theirs, b"end")
        thread.join()
        os.close(ours)
        os.close(theirs)


@contextmanager
def echoing_socket() -> Iterator[str]:
    """Yield the URL of a socket that returns what its one client sends."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def echo() -> None:
            client, _ = listener.accept()
            with client:
                while data := client.recv(4096):
                    client.sendall(data)

        thread = threading.Thread(target=echo)
        thread.start()
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
        thread.join()


@contextmanager
def echoing_bridge() -> Iterator[str]:
    with echoing_socket() as port, bridged(port) as url:
        yield url


@contextmanager
def loop() -> Iterator[str]:
    yield "loop://"


@contextmanager
def echoing_chip() -> Iterator[str]:
    """Yield the URL of a CP2110 behind a `hid` module of our own."""
    sent: queue.Queue[list[int]] = queue.Queue()

    class Device:
        def open_path(self, path: bytes) -> None:
            assert path == b"/dev/hidraw9"

        def send_feature_report(self, report: bytes) -> None:
            assert report

        def write(self, report: bytes) -> None:
            sent.put(list(report))

        def read(self, length: int, timeout_ms: int) -> list[int]:
            try:
                return sent.get(timeout=timeout_ms / 1000.0)
            except queue.Empty:
                return []

        def close(self) -> None:
            pass

    module = ModuleType("hid")
    module.device = Device  # type: ignore[attr-defined]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "hid", module)
        patch.delitem(sys.modules, "serial.urlhandler.protocol_cp2110", raising=False)
        yield "cp2110:///dev/hidraw9"
        sys.modules.pop("serial.urlhandler.protocol_cp2110", None)


@contextmanager
def on_a_pty(scheme: str) -> Iterator[str]:
    with echoing_pty() as pty, pytest.MonkeyPatch.context() as patch:
        patch.setattr(serial.tools.list_ports, "grep", lambda pattern: [(pty, "", pattern)])
        yield {"": pty, "hwgrep": "hwgrep://board"}.get(scheme, f"{scheme}://{pty}")


ECHOES: dict[str, Callable[[], AbstractContextManager[str]]] = {
    **{scheme: partial(on_a_pty, scheme) for scheme in ON_DEVICES},
    "socket": echoing_socket,
    "rfc2217": echoing_bridge,
    "loop": loop,
    "cp2110": echoing_chip,
}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_line_carries_bytes_both_ways(scheme: str) -> None:
    with ECHOES[scheme]() as url:
        line = open_line(url)
        try:
            line.write(b"round \xff\x00")
            got, end_s = b"", monotonic() + PATIENCE_S
            while len(got) < 8 and monotonic() < end_s:
                got += line.read(PATIENCE_S)
            assert got == b"round \xff\x00"
            if SCHEMES[scheme].is_device:
                with pytest.raises(LinkLost) as held:
                    open_line(url)
                assert scheme == "hwgrep" or f"process {os.getpid()}" in held.value.message
        finally:
            line.close()


@pytest.mark.parametrize(
    ("url", "code"),
    [
        ("loop://?logging=loud", "E4002"),
        ("hwgrep://(", "E4002"),
        ("hwgrep://x&n", "E4002"),
        ("alt:///dev/null?class=serial_for_url", "E4002"),
        ("spy:///dev/null?colour", "E4002"),
        ("cp2110:///dev/hidraw9", "E4002"),  # without hidapi
        ("rfc2217://here", "E4002"),
        ("rfc2217://127.0.0.1:1", "E4001"),
        ("rfc2217://127.0.0.1:99999999", "E4002"),
        ("rfc2217://127.0.0.1:1?timeout=abc", "E4002"),
        ("spy:///dev/null?file=/dev/null/x", "E4002"),
        ("HWGREP://no such port", "E4001"),
        ("tcp://127.0.0.1:1", "E4002"),
    ],
)
def test_whatever_pyserial_raises_is_an_error_of_the_link(
    url: str, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "hid", None)
    monkeypatch.delitem(sys.modules, "serial.urlhandler.protocol_cp2110", raising=False)
    with pytest.raises(LinkLost) as error:
        open_line(url)
    assert (error.value.code, bool(error.value.hint)) == (code, True)
    assert url in error.value.message


def test_the_page_lists_what_each_scheme_supports() -> None:
    known = {
        path.stem.removeprefix("protocol_") for path in Path(serial.urlhandler.__path__[0]).glob("protocol_*")
    }
    assert {*known, ""} == set(SCHEMES)
    page = PAGE.read_text(encoding="utf-8")
    for scheme in SCHEMES.values():
        words = ["yes" if has else "no" for has in (scheme.is_device, scheme.is_device, scheme.write_timeout)]
        assert f"| `{scheme.form}` | {' | '.join(words)} |" in page
