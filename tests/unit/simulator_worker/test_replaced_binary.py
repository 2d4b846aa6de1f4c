"""A binary that is replaced on disk while a session lasts is not flown as the one before."""

from __future__ import annotations

import platform
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from saflite.contract.errors import Refused
from saflite.contract.target import Slot, Snapshot
from saflite.contract.test_case import Scenario, Target, TestCase
from saflite.flight.autopilots.ardupilot.adapter import ADAPTER
from saflite.flight.autopilots.external.elf import MACHINES
from saflite.flight.autopilots.external.listing import Listing
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.targets._external import ForkingExternalSession

NUMBER = {name: number for number, name in MACHINES.items()}[platform.machine()]
CASE = TestCase(target=Target(name="ardupilot"), scenario=Scenario())


def never() -> bool:
    """Never stop."""
    return False


def build(path: Path, extra: bytes) -> Path:
    words = b"\0".join((b"", b"ArduCopter V4.5.7", b"JSON control interface set to %s", extra, b""))
    head = b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HH", 2, NUMBER)
    path.write_bytes(head + bytes(44) + words)
    path.chmod(0o755)
    return path


@pytest.mark.parametrize(
    "fly",
    [
        lambda session: session.fly(CASE, 1.0, never),
        lambda session: session.fly_cold(CASE, 1.0, never),
        lambda session: session.snapshot(CASE, 0.0, 1.0, never),
        lambda session: session.fly_from(Snapshot(0, 0.0), CASE, 1.0, never),
    ],
    ids=["fly", "from power-up", "hold", "from a snapshot"],
)
def test_no_way_to_fly_takes_the_new_for_the_old(tmp_path: Path, fly: Callable[[ForkingExternalSession], None]) -> None:
    path = build(tmp_path / "arducopter", b"")
    slot = Slot(index=0, folder=tmp_path / "slot", ports=range(21_000, 21_020), clock=WallClock())
    binary = ADAPTER.binaries.inspect(path)
    session = ForkingExternalSession(slot, ADAPTER, binary, Listing(binary=binary.digest, parameters={}))
    build(tmp_path / "new", b"mended").replace(path)
    with pytest.raises(Refused, match="got another in its place"):
        fly(session)
