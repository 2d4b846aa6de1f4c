"""The links of the simulator build beside MAVLink: its receiver, and how its telemetry is called."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external.link import CENTRE_US, LOOPBACK, LOW_US

CHANNELS = 16
CONNECT_S = 5.0


class Radio:
    """The receiver: pulses of 16 channels, sent before every tick as the simulator build takes them."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((LOOPBACK, port))
        self.pulses_us = [CENTRE_US] * CHANNELS
        self.pulses_us[2] = LOW_US

    def send(self) -> None:
        """Send the pulses once; where nobody takes them, another link tells that."""
        with suppress(OSError):
            self._socket.send(struct.pack(f"<{CHANNELS}H", *self.pulses_us), socket.MSG_DONTWAIT)

    def fileno(self) -> int:
        """Return the number of the socket."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def called_tcp(port: int) -> socket.socket:
    """Return the link to the autopilot, which listens already; raises Unavailable where it does not answer."""
    try:
        made = socket.create_connection((LOOPBACK, port), timeout=CONNECT_S)
    except OSError as fault:
        raise Unavailable(f"port {port}: {fault}") from fault
    made.settimeout(CONNECT_S)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return made
