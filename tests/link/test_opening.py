"""From a port's name to an open line: each failure is one error with its own code and a remedy."""

from __future__ import annotations

import errno
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from time import monotonic

import pytest
import serial

from edmctl.errors import LinkLost
from edmctl.files import lock_holder
from edmctl.link import opening
from edmctl.link.opening import known_ports, open_line
from edmctl.link.ports import PortInfo

PATIENCE_S = 10.0
LISTED = [PortInfo("/dev/ttyACM7"), PortInfo("/dev/ttyUSB3")]


@pytest.fixture(autouse=True)
def _known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "listed_ports", lambda: LISTED)


@pytest.fixture
def pty() -> Iterator[str]:
    """Return the name of a pty."""
    ours, theirs = os.openpty()
    yield os.ttyname(theirs)
    os.close(theirs)
    os.close(ours)


def refused(url: str, wait_s: float = 0.0) -> LinkLost:
    with pytest.raises(LinkLost) as error:
        open_line(url, wait_s=wait_s)
    assert error.value.hint
    return error.value


def test_a_port_is_opened_under_its_name_or_a_link_to_it(pty: str, tmp_path: Path) -> None:
    link = tmp_path / "edm"
    link.symlink_to(pty)
    for name in (pty, str(link)):
        line = open_line(name)
        assert line.name == name
        line.close()


def test_a_port_that_is_not_there_tells_which_are(tmp_path: Path) -> None:
    error = refused(str(tmp_path / "ttyACM0"))
    assert error.code == "E4001"
    assert "/dev/ttyACM7, /dev/ttyUSB3" in error.hint


def test_without_any_port_this_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "listed_ports", list)
    assert known_ports() == "This computer lists no serial ports."


def test_what_is_no_port_is_never_written_to(tmp_path: Path) -> None:
    file = tmp_path / "profile.toml"
    file.write_text("precious")
    error = refused(str(file))
    assert (error.code, "a plain file" in error.message) == ("E4002", True)
    assert file.read_text() == "precious"
    error = refused(str(tmp_path))
    assert (error.code, "a folder" in error.message) == ("E4002", True)


@pytest.mark.parametrize("url", ["/dev/null", "nothing://x", "socket://here", "socket://127.0.0.1:99999"])
def test_devices_and_addresses_that_are_no_ports_are_refused(url: str) -> None:
    error = refused(url)
    assert error.code == "E4002"
    assert url in error.message


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM])
def test_missing_rights_come_with_the_remedy(number: int, pty: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbid(url: str, baud: int) -> serial.Serial:
        raise serial.SerialException(number, f"could not open port {url}")

    monkeypatch.setattr(opening, "open_port", forbid)
    error = refused(pty, wait_s=PATIENCE_S)
    assert error.code == "E4004"
    assert pty in error.message
    assert "right" in error.hint or "dialout" in error.hint


def test_any_other_failure_is_told_in_the_words_of_the_system(
    pty: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(url: str, baud: int) -> serial.Serial:
        raise serial.SerialException(errno.EIO, f"could not open port {url}")

    monkeypatch.setattr(opening, "open_port", fail)
    error = refused(pty)
    assert error.code == "E4001"
    assert os.strerror(errno.EIO) in error.message


def test_a_held_port_names_its_holder(pty: str) -> None:
    line = open_line(pty)
    try:
        error = refused(pty)
    finally:
        line.close()
    assert error.code == "E4006"
    assert f"process {os.getpid()} (" in error.message
    assert "--wait" in error.hint


def test_a_held_port_is_still_told_where_nobody_knows_the_holder(
    pty: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "lock_holder", lambda _: "")
    line = open_line(pty)
    try:
        assert "by another program" in refused(pty).message
    finally:
        line.close()


def test_a_port_that_nobody_holds_has_no_holder(pty: str, tmp_path: Path) -> None:
    assert lock_holder(tmp_path / "none") == ""
    assert lock_holder(Path(pty)) == ""


def test_waiting_gets_the_port_when_it_is_released(pty: str) -> None:
    holder = open_line(pty)
    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        threading.Timer(0.02, holder.close).start()

    line = open_line(pty, wait_s=PATIENCE_S, say=say)
    line.close()
    assert len(said) == 1
    assert "is held by process" in said[0]
    assert "Waiting up to 10 s." in said[0]


def test_waiting_gets_a_port_that_appears(pty: str, tmp_path: Path) -> None:
    link = tmp_path / "edm"
    line = open_line(str(link), wait_s=PATIENCE_S, say=lambda _: link.symlink_to(pty))
    line.close()


def test_waiting_has_an_end(pty: str) -> None:
    holder = open_line(pty)
    begin_s = monotonic()
    try:
        assert refused(pty, wait_s=0.02).code == "E4006"
    finally:
        holder.close()
    assert 0.02 <= monotonic() - begin_s < PATIENCE_S


def test_nobody_waits_for_what_will_never_be_a_port(tmp_path: Path) -> None:
    begin_s = monotonic()
    assert refused(str(tmp_path), wait_s=PATIENCE_S).code == "E4002"
    assert monotonic() - begin_s < 0.5 * PATIENCE_S


def test_a_socket_that_nobody_serves_is_absent() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"socket://127.0.0.1:{listener.getsockname()[1]}"
    error = refused(url)
    assert error.code == "E4001"
    assert os.strerror(errno.ECONNREFUSED) in error.message
