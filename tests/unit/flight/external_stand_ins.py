"""What tests of autopilots from outside stand in for: a silent port, a program that counts its steps."""

from __future__ import annotations

import subprocess
from typing import Any


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


def message(kind: str, **fields: Any) -> Any:
    """Return a message as it comes from the vehicle: packed and read again."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    made = dialect.mavlink_map[getattr(dialect, f"MAVLINK_MSG_ID_{kind}")]
    values = [fields.get(name, [0] * 4 if "[" in name else 0) for name in made.fieldnames]
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    return dialect.MAVLink(None).parse_buffer(made(*values).pack(link))[0]
