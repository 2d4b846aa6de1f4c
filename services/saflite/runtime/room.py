"""Looks whether the disk of a run is full before something has to be saved: that may be as late as a flight's end."""

from __future__ import annotations

from typing import Protocol

LOOK_S = 0.5
BYTES_MIN = 2**16


class Disk(Protocol):
    """What lies on the disk."""

    def room_bytes(self) -> int | None:
        """Return how much it takes yet, None where that is not known."""
        ...


class Room:
    """The room there is on a disk, looked at now and then."""

    def __init__(self, disk: Disk) -> None:
        self._disk, self._due_s = disk, 0.0

    def trouble(self, now_s: float) -> str:
        """Return in words that there is no room, empty if there is some or it is not yet time to look again."""
        if now_s < self._due_s:
            return ""
        self._due_s = now_s + LOOK_S
        room = self._disk.room_bytes()
        return "" if room is None or room >= BYTES_MIN else f"the disk of the run is full: {room} bytes are left"
