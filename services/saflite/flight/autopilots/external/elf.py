"""Whether a file is a program that this machine runs, by the ELF header."""

from __future__ import annotations

import platform

from saflite.contract.errors import Refused

ELF = b"\x7fELF"
MACHINES = {3: "i686", 40: "armv7l", 62: "x86_64", 183: "aarch64", 243: "riscv64"}  # e_machine


def check_program(head: bytes, where: str, wanted: str) -> None:
    """Raise Refused where a file that begins with `head` (20 bytes) is no program for this machine."""
    if head[:4] != ELF:
        raise Refused("autopilot", where=where, expected="a program (ELF)", got="another kind of file", fix=wanted)
    order = "little" if head[5] == 1 else "big"
    number = int.from_bytes(head[18:20], "little" if order == "little" else "big")
    machine = MACHINES.get(number, f"processor {number}")
    if machine != platform.machine() or order != "little":
        raise Refused("autopilot", where=where, expected=f"one for {platform.machine()}", got=f"one for {machine}")
