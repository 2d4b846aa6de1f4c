"""Network namespaces of one test, each joined to this one by a cable (a veth pair) that only the two of them know."""

from __future__ import annotations

import os
import shutil
import subprocess
from types import TracebackType


def why_not() -> str:
    """Return why no namespace can be made here, empty if one can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "network namespaces need the program `ip` (Debian: iproute2)"
    name = f"saflite-try-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False)
    if made.returncode != 0:
        return f"network namespaces are not allowed here: {made.stderr.decode().strip()}"
    subprocess.run(["ip", "netns", "del", name], check=False)
    return ""


class NetworkNamespace:
    """Open it with `with`; `host_ip` is this side's address, `prefix` puts a command inside. Nothing is left behind.

    A test that wants several numbers them, 0 to 9. Each reaches all addresses of this side.
    """

    def __init__(self, number: int = 0) -> None:
        tag, net = f"{os.getpid()}{'abcdefghij'[number]}", f"10.214.{os.getpid() % 250}"
        self.name = f"saflite-{tag}"
        self._outside, self._inside = f"sfo{tag}", f"sfi{tag}"
        self.host_ip, self._guest_ip = f"{net}.{4 * number + 1}", f"{net}.{4 * number + 2}"

    @property
    def prefix(self) -> tuple[str, ...]:
        """What puts a command inside."""
        return ("ip", "netns", "exec", self.name)

    def cut(self) -> None:
        """Pull the cable: what either side sends is lost, and neither is told."""
        subprocess.run([*self.prefix, "ip", "link", "set", self._inside, "down"], check=True)

    def __enter__(self) -> NetworkNamespace:
        inside = " ".join(self.prefix)
        for command in (
            f"ip netns add {self.name}",
            f"ip link add {self._outside} type veth peer name {self._inside}",
            f"ip link set {self._inside} netns {self.name}",
            f"ip addr add {self.host_ip}/30 dev {self._outside}",
            f"ip link set {self._outside} up",
            f"{inside} ip addr add {self._guest_ip}/30 dev {self._inside}",
            f"{inside} ip link set {self._inside} up",
            f"{inside} ip route add default via {self.host_ip}",
        ):
            subprocess.run(command.split(), check=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        subprocess.run(["ip", "netns", "del", self.name], check=False)
        subprocess.run(["ip", "link", "del", self._outside], capture_output=True, check=False)
