"""Nobody but its own world reaches an autopilot: neither other users of the host nor the network."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from saflite.conformance.flying import opened
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.evidence.memory import MemoryBlobs
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.registry import load_target, why_missing
from saflite.simulator_worker.slots import slots_folder, take_slot
from saflite.simulator_worker.work import Flyer, open_service

pytestmark = pytest.mark.live

LISTENS = '''"""Listens at all addresses while it flies, as simulator builds do, and says who came."""
import os, socket, time
import msgspec, numpy as np
from saflite.contract.flight import FlightRecord, Trace
from saflite.simulator_worker.targets import reference

own_network = OWN

def describe():
    return msgspec.structs.replace(reference.describe(), name=NAME, snapshots=False)

def check(test_case):
    pass

def open(slot):
    return Session(slot)

class Session:
    def __init__(self, slot):
        self.slot = slot

    def fly(self, test_case, deadline_s, cancelled):
        with socket.create_server(("0.0.0.0", self.slot.ports[0])) as server:
            with socket.create_connection(("127.0.0.1", self.slot.ports[0])), server.accept()[0]:
                pass  # its own world reaches it
            server.settimeout(0.2)
            (self.slot.folder / "listening").write_text(str(self.slot.ports[0]))
            came = "nobody"
            while not (self.slot.folder / "tried").exists():
                try:
                    server.accept()[0].close()
                    came = "somebody"
                except TimeoutError:
                    pass
        (self.slot.folder / "listening").unlink()
        column = np.full(10, 9.0, dtype="<f4").tobytes()
        trace = Trace(step_s=0.1, signals=dict.fromkeys(describe().signals, column))
        return FlightRecord("completed", trace, f"{came} came to process {os.getpid()}")

    def close(self):
        pass
'''


@pytest.fixture
def flyer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Flyer]:
    monkeypatch.setenv("SAFLITE_SLOTS", str(tmp_path / "slots"))
    for name, own in (("alone", True), ("amid", False)):
        text = LISTENS.replace("OWN", str(own)).replace("NAME", repr(name))
        (tmp_path / f"{name}.py").write_text(text)
    made = open_service("fly-1", WallClock(), MemoryBlobs(), [tmp_path / "alone.py", tmp_path / "amid.py"])
    yield made
    made.close()


def _may() -> bool:
    words = "import sys; from saflite.simulator_worker import own_network; sys.exit(not own_network.enter())"
    return subprocess.run([sys.executable, "-c", words], check=False).returncode == 0


def _flown(flyer: Flyer, name: str) -> tuple[str, int]:
    """Fly while somebody else of this host calls; return whether they came through, and the simulator's process."""
    with ThreadPoolExecutor(1) as others:
        call = others.submit(_call)
        record = flyer._sandbox.fly(TestCase(target=Target(name=name), scenario=Scenario()), 60.0, lambda: False)
        called = call.result()
    assert record.ending == "completed", record.message
    assert record.message.startswith("somebody" if called else "nobody"), record.message
    return ("reached" if called else "alone"), int(record.message.rpartition(" ")[2])


def _call() -> bool:
    until_s = time.monotonic() + 60.0
    while time.monotonic() < until_s:
        for told in slots_folder().glob("*/listening"):
            if not (words := told.read_text()):
                continue
            port = int(words)
            try:
                socket.create_connection(("127.0.0.1", port), timeout=5.0).close()
                reached = True
            except OSError:
                reached = False
            time.sleep(0.5)  # for whoever listens to take notice
            (told.parent / "tried").touch()
            return reached
        time.sleep(0.01)
    raise AssertionError("nobody ever listened")


def test_an_autopilot_is_reached_by_its_world_only(flyer: Flyer) -> None:
    if not _may():
        pytest.skip("this user may make no network of its own here")
    assert _flown(flyer, "alone")[0] == "alone"


def test_other_targets_stay_where_they_are_even_after_one_that_was_alone(flyer: Flyer) -> None:
    _, first = _flown(flyer, "amid")
    _, alone = _flown(flyer, "alone")
    after, last = _flown(flyer, "amid")
    assert after == "reached"
    assert len({first, alone, last}) == 3


def test_the_ports_of_a_slot_stay_claimed(flyer: Flyer) -> None:
    """The claim is a name in the network: it belongs to the worker, whose simulator may be elsewhere."""
    _flown(flyer, "alone")
    other = take_slot()
    try:
        assert other.info.index != flyer._sandbox._slot.info.index  # type: ignore[union-attr]
        assert other.info.first_port != flyer._sandbox._slot.info.first_port  # type: ignore[union-attr]
    finally:
        other.release()


def _inodes_of_ports() -> set[str]:
    tables = (Path(f"/proc/net/{kind}").read_text().splitlines()[1:] for kind in ("tcp", "tcp6", "udp", "udp6"))
    return {line.split()[9] for table in tables for line in table}


def _sockets(pid: int) -> set[str]:
    links = [os.readlink(one) for one in Path(f"/proc/{pid}/fd").iterdir() if one.is_symlink()]
    return {link[8:-1] for link in links if link.startswith("socket:[")}


def test_betaflight_has_no_ports() -> None:
    if why_missing("betaflight_stock"):
        pytest.skip(why_missing("betaflight_stock"))
    before = set(children(os.getpid()))
    with opened(load_target("betaflight_stock")) as session, socket.create_server(("127.0.0.1", 0)):
        start = StartState(mode="ANGLE", altitude_m=10.0)
        case = TestCase(target=Target(name="betaflight_stock"), scenario=Scenario(start=start, time_limit_s=2.0))
        assert session.fly(case, 60.0, lambda: False).ending == "completed"
        alive = [pid for pid in children(os.getpid()) if pid not in before]
        assert any(_sockets(pid) for pid in alive), "the firmware that flights are forked from is held"
        assert _sockets(os.getpid()) & _inodes_of_ports(), "ports are found where there are any"
        assert [pid for pid in alive if _sockets(pid) & _inodes_of_ports()] == []
