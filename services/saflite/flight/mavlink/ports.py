"""Where MAVLink bytes come from and go to: TCP and UDP sockets, none of which ever blocks longer than asked.

Endpoints: `tcp:HOST:PORT` waits for peers, `tcpout:HOST:PORT` calls one, `udp:HOST:PORT` answers whoever writes to it,
`udpout:HOST:PORT` talks to one.
"""

from __future__ import annotations

import logging
import selectors
import socket
from typing import Protocol

from saflite.contract.errors import Refused, Unavailable

log = logging.getLogger(__name__)

READ_BYTES, CLIENTS_MAX, BACKLOG_BYTES = 65536, 8, 1 << 20
CONNECT_S = 5.0
KINDS = ("tcp", "tcpout", "udp", "udpout")


class Port(Protocol):
    """Where bytes come from and go to."""

    name: str

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send `data` to everyone connected and return what came in, waiting at most `wait_s`."""
        ...

    def close(self) -> None:
        """Close all sockets."""
        ...


class TcpPort:
    """A TCP server for up to eight peers; one that does not read is dropped."""

    def __init__(self, host: str, port: int) -> None:
        self._selector = selectors.DefaultSelector()
        self._server = _bound(socket.SOCK_STREAM, host, port)
        self._server.listen()
        self._server.setblocking(False)
        self._selector.register(self._server, selectors.EVENT_READ)
        self._waiting: dict[socket.socket, bytearray] = {}
        self.name = "tcp:{}:{}".format(*self._server.getsockname()[:2])

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send, accept, receive."""
        for client in tuple(self._waiting):
            self._send(client, data)
        received = bytearray()
        for key, _ in self._selector.select(wait_s):
            if key.fileobj is self._server:
                self._accept()
            elif isinstance(key.fileobj, socket.socket):
                received += self._receive(key.fileobj)
        return bytes(received)

    def _accept(self) -> None:
        try:
            client, address = self._server.accept()
        except OSError as fault:  # a peer that is gone again, or no more files may be opened: the others fly on
            log.warning("a peer could not be let in: %s", fault)
            return
        if len(self._waiting) >= CLIENTS_MAX:
            client.close()
            return
        client.setblocking(False)
        self._selector.register(client, selectors.EVENT_READ)
        self._waiting[client] = bytearray()
        log.info("peer %s connected", address)

    def _send(self, client: socket.socket, data: bytes) -> None:
        backlog = self._waiting[client]
        backlog += data
        try:
            while backlog:
                del backlog[: client.send(backlog)]
        except BlockingIOError:
            if len(backlog) > BACKLOG_BYTES:
                self._drop(client)
        except OSError:
            self._drop(client)

    def _receive(self, client: socket.socket) -> bytes:
        try:
            data = client.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop(client)
        return data

    def _drop(self, client: socket.socket) -> None:
        if self._waiting.pop(client, None) is not None:
            self._selector.unregister(client)
            client.close()

    def close(self) -> None:
        """Close all sockets."""
        for client in tuple(self._waiting):
            self._drop(client)
        self._selector.close()
        self._server.close()


class UdpPort:
    """UDP, either waiting for peers or talking to one."""

    def __init__(self, host: str, port: int, *, out: bool) -> None:
        self._socket = (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) if out else _bound(socket.SOCK_DGRAM, host, port)
        )
        self._socket.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._peers: list[tuple[str, int]] = [(host, port)] if out else []
        bound = (host, port) if out else self._socket.getsockname()[:2]
        self.name = f"{'udpout' if out else 'udp'}:{bound[0]}:{bound[1]}"

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send to every peer heard so far, receive."""
        for peer in self._peers:
            for start in range(0, len(data), 1200):
                self._send(data[start : start + 1200], peer)
        received = bytearray()
        while self._selector.select(wait_s):
            wait_s = 0.0
            try:
                part, peer = self._socket.recvfrom(READ_BYTES)
            except OSError:
                break
            if peer not in self._peers:
                self._peers = [*self._peers, peer][-CLIENTS_MAX:]
            received += part
        return bytes(received)

    def _send(self, data: bytes, peer: tuple[str, int]) -> None:
        try:
            self._socket.sendto(data, peer)
        except OSError as fault:
            log.debug("cannot reach %s: %s", peer, fault)

    def close(self) -> None:
        """Close the socket."""
        self._selector.close()
        self._socket.close()


class TcpClientPort:
    """A call to one TCP server; what it does not take yet waits, up to a mebibyte.

    Raises:
        Unavailable: nobody answers; also by `exchange` once the peer has hung up or does not read.
    """

    def __init__(self, host: str, port: int) -> None:
        self.name = f"tcpout:{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        except (OSError, UnicodeError, OverflowError) as fault:  # the latter two of names and ports that are none
            raise Unavailable(f"{host}:{port}: {fault}") from fault
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._backlog = bytearray()

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send, receive."""
        self._backlog += data
        received = bytearray()
        try:
            self._send()
            while self._selector.select(wait_s):
                wait_s = 0.0
                part = self._socket.recv(READ_BYTES)
                if not part:
                    raise ConnectionResetError("the peer has hung up")
                received += part
        except OSError as fault:
            if not received:
                raise Unavailable(f"{self.name}: {fault}") from fault
        return bytes(received)

    def _send(self) -> None:
        try:
            while self._backlog:
                del self._backlog[: self._socket.send(self._backlog)]
        except BlockingIOError as fault:
            if len(self._backlog) > BACKLOG_BYTES:
                raise ConnectionResetError("the peer does not read") from fault

    def close(self) -> None:
        """Close the socket."""
        self._selector.close()
        self._socket.close()


def open_port(endpoint: str) -> Port:
    """Return the port for an endpoint; raises Refused for a malformed one, Unavailable if it cannot be bound."""
    kind, _, rest = endpoint.partition(":")
    host, _, number = rest.rpartition(":")
    if kind not in KINDS or not host or not number.isdigit() or int(number) > 65535:
        raise Refused("endpoint", expected=" or ".join(f"{kind}:HOST:PORT" for kind in KINDS), got=repr(endpoint))
    if kind in ("tcp", "tcpout"):
        return TcpPort(host, int(number)) if kind == "tcp" else TcpClientPort(host, int(number))
    return UdpPort(host, int(number), out=kind == "udpout")


def _bound(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, kind)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((host, port))
    except OSError as fault:
        made.close()
        raise Unavailable(f"{host}:{port}: {fault}") from fault
    return made
