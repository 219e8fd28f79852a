"""A virtual controller served on a pty or a socket, and an RFC 2217 bridge."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import serial
from serial.rfc2217 import PortManager

from edmctl.simulator import VirtualBench
from edmctl.simulator.serve import Endpoint, PtyEndpoint, Server


@contextmanager
def serving(
    bench: VirtualBench,
    speed: float | None = None,
    endpoint: Endpoint | None = None,
) -> Iterator[str]:
    """Serve `bench` in a thread while the block runs, by default on a pty with a driven clock; yields its name."""
    endpoint, over = endpoint or PtyEndpoint(), threading.Event()
    server = Server(bench, endpoint, speed)
    thread = threading.Thread(target=server.run, args=(over.is_set,), name="server")
    thread.start()
    try:
        yield endpoint.name
    finally:
        over.set()
        thread.join()
        endpoint.close()


@contextmanager
def bridged(port: str) -> Iterator[str]:
    """Bridge a port to one client by RFC 2217 in a thread while the block runs; yields the URL for the client."""
    over, ready = socket.socketpair()
    with (
        over,
        ready,
        socket.create_server(("127.0.0.1", 0)) as listener,
        serial.serial_for_url(port, timeout=0) as line,
    ):
        thread = threading.Thread(target=_bridge, args=(listener, line, over), name="bridge")
        thread.start()
        try:
            yield f"rfc2217://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            ready.close()
            thread.join()


def _bridge(listener: socket.socket, line: serial.Serial, over: socket.socket) -> None:
    if over in select.select([listener, over], [], [])[0]:
        return
    connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with connection:
        # It needs of the connection only a method that sends.
        manager = PortManager(cast("Any", line), cast("Any", SimpleNamespace(write=connection.sendall)))
        sources = [connection.fileno(), line.fileno(), over.fileno()]
        while over.fileno() not in (waiting := select.select(sources, [], [])[0]):
            if connection.fileno() in waiting:
                data = connection.recv(65536)
                if not data:
                    return
                line.write(b"".join(manager.filter(data)))
            if line.fileno() in waiting:
                connection.sendall(b"".join(manager.escape(line.read(65536))))
