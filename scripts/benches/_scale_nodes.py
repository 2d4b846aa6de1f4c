"""Nodes of the bench `scale`: network namespaces with addresses of their own, on a bridge that nobody else reaches."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NamedTuple

FARM_IP = "10.215.0.1"  # moves with the farm


class Node(NamedTuple):
    """A network namespace; `cable` is the end of its link that lies outside."""

    name: str
    cable: str
    inside: str

    @property
    def prefix(self) -> tuple[str, ...]:
        """What puts a command inside."""
        return ("ip", "netns", "exec", self.name)

    def cut(self) -> None:
        """Pull the cable."""
        _ip(f"link set {self.cable} down")

    def mend(self) -> None:
        """Plug the cable in again."""
        _ip(f"link set {self.cable} up")

    def take(self, address: str) -> None:
        """Have an address from now on."""
        _ip(f"addr add {address}/16 dev {self.inside}", self.prefix)

    def kill(self) -> None:
        """End everything that runs on the node at once (SIGKILL), and take the farm's address away if it has it."""
        pids = subprocess.run(["ip", "netns", "pids", self.name], capture_output=True, text=True, check=True).stdout
        for pid in pids.split():
            with suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)
        subprocess.run(
            [*self.prefix, "ip", "addr", "del", f"{FARM_IP}/16", "dev", self.inside], capture_output=True, check=False
        )


@contextmanager
def nodes(count: int, *, farm_here: bool = False) -> Iterator[list[Node]]:
    """Make nodes 10.215.1.1, 10.215.1.2, ... on a bridge of their own, and remove them.

    `farm_here` gives the farm's address to this side. They are removed, too, where this process is asked to end.
    """
    with _told_to_end():
        yield from _made(count, farm_here)


@contextmanager
def _told_to_end() -> Iterator[None]:
    """Turn SIGTERM and a closed terminal into an exception, once: what is cleaned up then is cleaned up whole."""
    ends = (signal.SIGTERM, signal.SIGHUP)

    def end(number: int, _frame: FrameType | None) -> None:
        for one in ends:
            signal.signal(one, signal.SIG_IGN)
        raise SystemExit(128 + number)

    before = {number: signal.signal(number, end) for number in ends}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _made(count: int, farm_here: bool) -> Iterator[list[Node]]:
    tag = os.getpid() % 100_000
    bridge, made = f"sfb{tag}", list[Node]()
    try:
        _ip(f"link add {bridge} type bridge")
        Path(f"/proc/sys/net/ipv4/conf/{bridge}/arp_ignore").write_text(
            "1"
        )  # or this side answers for all its addresses
        _ip(f"link set {bridge} up")
        if farm_here:
            _ip(f"addr add {FARM_IP}/16 dev {bridge}")
        for number in range(count):
            node = Node(f"sfscale-{os.getpid()}-{number}", f"sf{tag}o{number}", f"sf{tag}i{number}")
            _ip(f"netns add {node.name}")
            made.append(node)
            _ip(f"link add {node.cable} type veth peer name {node.inside}")
            _ip(f"link set {node.inside} netns {node.name}")
            _ip(f"link set {node.cable} master {bridge} up")
            _ip("link set lo up", node.prefix)
            _ip(f"link set {node.inside} up", node.prefix)
            node.take(f"10.215.1.{number + 1}")
        yield made
    finally:
        for node in made:
            # the cable first, by name: with its namespace it would go, too, but later, when the kernel gets to it
            subprocess.run(["ip", "link", "del", node.cable], capture_output=True, check=False)
            subprocess.run(["ip", "netns", "del", node.name], check=False)
        subprocess.run(["ip", "link", "del", bridge], capture_output=True, check=False)


def _ip(words: str, prefix: tuple[str, ...] = ()) -> None:
    subprocess.run([*prefix, "ip", *words.split()], check=True)
