"""What a build starts while it is asked for its parameters ends with the asking, as it does with a flight."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import pytest

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.ardupilot.adapter import ADAPTER
from saflite.flight.autopilots.external.aircraft import Aircraft
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.place import FailedBringUp, Place
from saflite.flight.autopilots.external.process import Process
from saflite.simulator_worker.targets._external import ExternalTarget

BUILD = Binary(Path("/nowhere/arducopter"), "0" * 64, "ArduCopter V4.5.7")
LEAVES_ONE = "setsid sleep 600 & echo left $! behind; wait"


def test_a_build_that_is_asked_leaves_no_process_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One in a session of its own outlived the asking, and the command that asked."""
    monkeypatch.setenv("SAFLITE_SLOTS", str(tmp_path / "slots"))
    monkeypatch.setenv("SAFLITE_CACHE", str(tmp_path / "cache"))
    left = list[int]()

    def powered_up(binary: Binary, place: Place, parameters: Mapping[str, float]) -> Aircraft:
        process = Process(["/bin/sh", "-c", LEAVES_ONE], place.folder, environment={"PATH": os.defpath})
        assert process.wait_for_words("behind", 10.0), process.console
        left.extend(map(int, re.findall(r"left (\d+) behind", process.console)))
        process.end()
        raise FailedBringUp("it has left")

    try:
        with pytest.raises(Unavailable, match="it has left"):
            ExternalTarget(ADAPTER._replace(powered_up=powered_up))._asked(BUILD)
        assert left
        assert [pid for pid in left if Path(f"/proc/{pid}").exists()] == []
    finally:
        for pid in left:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
