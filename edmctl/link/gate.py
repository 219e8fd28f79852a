"""The gate before a served socket: lines of text that say whether somebody may begin to speak EDM Link.

`busy` turns a client away while another one speaks. `challenge` asks for the HMAC-SHA256 of its number with a
secret that both ends know, so that the secret itself never crosses the line; `ready` or `refused` follows. A server
without a secret says nothing to a client that it takes, and neither does a serial bridge. The gate keeps strangers
out; what comes behind it is neither encrypted nor signed.
"""

from __future__ import annotations

import hmac
import os
import select
import socket
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.errors import LinkLost

if TYPE_CHECKING:
    from serial import Serial

GREETING = b"edmctl-gate/1 "
BUSY, CHALLENGE, ANSWER, READY, REFUSED = b"busy", b"challenge", b"answer", b"ready", b"refused"
LONGEST_LINE = 128
"""No line of the gate is longer; what is longer without an end is none."""
LEAST_SECRET = 16
"""Bytes of a secret: a shorter one is guessed from one overheard answer."""
SILENT_SERVER_S = 0.1
"""So long a client looks whether the server speaks first; one that has a secret waits for the challenge."""
CHALLENGE_S = 1.0


def line_of(*words: bytes) -> bytes:
    """Return a line of the gate."""
    return GREETING + b" ".join(words) + b"\n"


def words_of(line: bytes) -> list[bytes]:
    """Return the words of a line of the gate; none where it is something else."""
    return line.removeprefix(GREETING).split() if line.startswith(GREETING) else []


def answer_to(number: bytes, secret: bytes) -> bytes:
    """Return the answer to a challenge, in hex."""
    return hmac.new(secret, number, "sha256").hexdigest().encode()


def pass_gate(name: str, port: Serial, secret: bytes) -> None:
    """Do what the server asks of a socket that was just opened; nothing where it says nothing.

    Raises LinkLost E4006 if another client is connected, E4023 without the right secret.
    """
    if os.name != "posix":  # a socket is no file there that could be looked at twice
        return
    with socket.socket(fileno=os.dup(port.fileno())) as line:
        words = _next_line(line, CHALLENGE_S if secret else SILENT_SERVER_S)
        if not words:
            return
        if not secret or words[0] != CHALLENGE or len(words) != 2:
            raise closed(name, words)
        line.sendall(line_of(ANSWER, answer_to(words[1], secret)))
        words = _next_line(line, CHALLENGE_S)
        if words[:1] != [READY]:
            raise closed(name, words)


def closed(name: str, words: list[bytes]) -> LinkLost:
    """Return the error of a gate that said this and lets nobody in."""
    if words[:1] == [BUSY]:
        return failures.port_held(name=name, owner="another client")
    if words[:1] == [CHALLENGE]:
        return failures.secret_needed(name=name)
    reason = "refused the secret" if words[:1] == [REFUSED] else "closed its gate without a word of why"
    return failures.secret_refused(name=name, reason=reason)


def _next_line(line: socket.socket, patience_s: float) -> list[bytes]:
    """Take a line of the gate off the socket, and leave anything else where it is."""
    end_s = monotonic() + patience_s
    while (left_s := end_s - monotonic()) > 0.0:
        if not select.select([line], [], [], left_s)[0]:
            break
        with suppress(OSError):
            seen = line.recv(LONGEST_LINE, socket.MSG_PEEK)
            if not seen.startswith(GREETING[: len(seen)]) or not seen:
                break
            if (end := seen.find(b"\n")) >= 0:
                return words_of(line.recv(end + 1))
            if len(seen) >= LONGEST_LINE:
                break
        select.select([], [], [], 0.002)  # the rest of the line is on its way
    return []
