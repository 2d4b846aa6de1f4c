"""A network that a simulator's process has to itself: a loopback which no other process of the host reaches.

Simulator builds of autopilots take state, sticks and orders from whoever reaches their ports, and listen at all
addresses: any user of the host, or of the network, could steer a flight.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct
from pathlib import Path

from saflite.contract.errors import Unavailable

_LIBC = ctypes.CDLL(None, use_errno=True)
_NEW_USERS, _NEW_NETWORK = 0x1000_0000, 0x4000_0000  # flags of unshare(2)
_SET_FLAGS, _UP, _REQUEST = 0x8914, 0x1, "16sh14x"  # SIOCSIFFLAGS and IFF_UP of netdevice(7), struct ifreq


def enter() -> bool:
    """Have this process, and what it starts from now on, in a network of its own; there is no way back.

    Returns whether the kernel lets this user; where it does not, all stays as it was. Without root's rights that takes
    user namespaces, which some systems deny, and a process of one thread.

    Raises:
        Unavailable: it could be entered, but not be brought up.
    """
    user, group = os.getuid(), os.getgid()
    if _LIBC.unshare(_NEW_NETWORK) != 0 and _LIBC.unshare(_NEW_USERS | _NEW_NETWORK) != 0:
        return False
    try:
        if os.getuid() != user:
            _stay(user, group)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, _SET_FLAGS, struct.pack(_REQUEST, b"lo", _UP))
    except OSError as fault:
        raise Unavailable(f"a network of its own for the autopilot: {fault}") from fault
    return True


def may_enter() -> bool:
    """Return whether the kernel would let this user, as a fork of this process tries."""
    child = os.fork()
    if child == 0:
        try:
            os._exit(0 if enter() else 1)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def _stay(user: int, group: int) -> None:
    """In new user namespaces, stay who we are."""
    for name, words in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
        Path(f"/proc/self/{name}").write_text(words)
