"""What tests of autopilots from outside stand in for: a silent port, a program that counts its steps."""

from __future__ import annotations

import subprocess


class Deaf:
    """A port from which nothing comes."""

    name = "deaf"

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        return b""

    def close(self) -> None:
        pass


def printed(running: subprocess.Popen[bytes], last: int) -> list[int]:
    """Return the steps that a program prints, up to `last`."""
    assert running.stdout is not None
    lines: list[int] = []
    while not lines or lines[-1] < last:
        lines.append(int(running.stdout.readline()))
    return lines
