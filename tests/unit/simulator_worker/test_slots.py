"""Slots: no two holders of one, freed with their holders, nothing left behind."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external.place import outside
from saflite.runtime.clock import WallClock
from saflite.simulator_worker import slots
from saflite.simulator_worker.slots import take_slot
from saflite.simulator_worker.targets._external import ExternalTarget

HOLDER = """
import sys
from pathlib import Path
from saflite.simulator_worker.slots import take_slot
from saflite.simulator_worker.targets._external import ExternalTarget
held = take_slot(Path(sys.argv[1]))
Path(held.info.folder, "log").write_text("x")
print(held.info.index, held.info.first_port, flush=True)
sys.stdin.read()
"""


def holder(root: Path) -> tuple[subprocess.Popen[str], int, int]:
    """Start a process that holds a slot; return it, the slot's number and first port."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(root)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    index, first_port = map(int, process.stdout.readline().split())
    return process, index, first_port


def test_slots_differ_in_number_folder_and_ports(tmp_path: Path) -> None:
    root = tmp_path / "slots"
    held = [take_slot(root) for _ in range(3)]
    infos = [one.info for one in held]
    assert [info.index for info in infos] == [0, 1, 2]
    assert len({info.folder for info in infos}) == 3
    ports = [port for info in infos for port in range(info.first_port, info.first_port + info.ports)]
    assert len(set(ports)) == len(ports)
    held[1].release()
    assert take_slot(root).info.index == 1


def test_slots_of_different_folders_share_no_port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two farms of one host, each with slots of its own; at ports that no other farm here claims meanwhile."""
    monkeypatch.setattr(slots, "PORTS_FIRST", slots.PORTS_FIRST + slots.SLOTS_MAX * slots.PORTS_EACH)
    one, other = take_slot(tmp_path / "one"), take_slot(tmp_path / "other")
    assert one.info.index == other.info.index == 0
    assert abs(one.info.first_port - other.info.first_port) >= one.info.ports
    first_port = one.info.first_port
    one.release()
    again = take_slot(tmp_path / "one")
    assert again.info.first_port == first_port
    again.release()
    other.release()


def test_who_claims_all_ports_of_the_host_stops_only_what_needs_some(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any local user can; all simulators of all farms then failed to start."""
    monkeypatch.setattr(slots, "PORTS_FIRST", slots.PORTS_FIRST + 2 * slots.SLOTS_MAX * slots.PORTS_EACH)
    monkeypatch.setattr(slots, "SLOTS_MAX", 3)
    theirs = [socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(3)]
    for number, claim in enumerate(theirs):
        claim.bind(f"\0saflite-ports-{slots.PORTS_FIRST + number * slots.PORTS_EACH}")
    held = [take_slot(tmp_path / "slots") for _ in range(3)]
    assert [one.info.ports for one in held] == [0, 0, 0]
    assert len({one.info.folder for one in held}) == 3
    slot = held[0].info.slot(WallClock())
    with pytest.raises(Unavailable, match="have claimed all"):
        ExternalTarget(cast(Any, None)).open(slot)
    for one in held:
        one.release()
    theirs[1].close()
    one = take_slot(tmp_path / "slots")
    assert (one.info.first_port, one.info.ports) == (slots.PORTS_FIRST + slots.PORTS_EACH, slots.PORTS_EACH)
    one.release()


def test_what_a_killed_autopilot_left_outside_its_folder_is_cleared_away(tmp_path: Path) -> None:
    """PX4's socket and lock file lie in /tmp whoever starts it; those of slots in use stay."""
    process, _, first_port = holder(tmp_path / "slots")
    held = take_slot(tmp_path / "slots")
    ours, theirs = outside(held.info.first_port), outside(first_port)
    for path in (*ours, *theirs):
        path.touch()
    held.empty()  # its simulator was killed, the other one flies
    assert [path.exists() for path in (*ours, *theirs)] == [False, False, True, True]
    ours[0].touch()
    process.kill()
    process.communicate()
    take_slot(tmp_path / "other").release()
    assert [path.exists() for path in (*ours, *theirs)] == [True, False, False, False]
    held.release()
    assert not ours[0].exists()


def test_files_of_an_autopilot_that_somebody_started_by_hand_stay(tmp_path: Path) -> None:
    theirs = outside(10_007)  # no slot has such ports
    for path in theirs:
        path.touch()
    try:
        take_slot(tmp_path / "slots").release()
        assert [path.exists() for path in theirs] == [True, True]
    finally:
        for path in theirs:
            path.unlink(missing_ok=True)


def test_a_released_slot_leaves_no_file(tmp_path: Path) -> None:
    root = tmp_path / "slots"
    held = take_slot(root)
    (Path(held.info.folder) / "log").write_text("x")
    held.release()
    held.release()
    assert not root.exists()


def test_the_slot_of_a_killed_process_is_free_and_empty(tmp_path: Path) -> None:
    root = tmp_path / "slots"
    first = take_slot(root)
    process, index, _ = holder(root)
    assert index == 1
    third = take_slot(root)
    assert third.info.index == 2
    process.kill()
    process.communicate()
    third.release()
    again = take_slot(root)
    assert (again.info.index, list(Path(again.info.folder).iterdir())) == (1, [])
    again.release()
    first.release()
    assert not root.exists()


def test_what_dead_holders_left_is_cleared_away(tmp_path: Path) -> None:
    root = tmp_path / "slots"
    root.mkdir(mode=0o700)
    (root / "7.lock").touch()
    (root / "7").mkdir()
    (root / "7" / "log").write_text("x")
    held = take_slot(root)
    assert sorted(path.name for path in root.iterdir()) == ["0", "0.lock"]
    held.release()


def test_a_folder_that_others_may_write_to_is_not_used(tmp_path: Path) -> None:
    root = tmp_path / "slots"
    root.mkdir()
    root.chmod(0o777)
    with pytest.raises(Unavailable, match="only we may write"):
        take_slot(root)
    link = tmp_path / "link"
    link.symlink_to(tmp_path)
    with pytest.raises(Unavailable):
        take_slot(link)
    assert os.listdir(root) == []


def test_what_another_user_made_under_our_name_keeps_nobody_from_flying(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SAFLITE_SLOTS", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.setattr(slots, "SHARED", str(tmp_path / "shared"))
    shared = Path(f"{tmp_path / 'shared'}-{os.getuid()}")
    assert slots.slots_folder() == shared
    shared.mkdir(mode=0o700)
    assert slots.slots_folder() == shared
    shared.chmod(0o777)  # as one that others made: they can write in it
    assert slots.slots_folder().is_relative_to(tmp_path / "runtime")
    shared.rmdir()
    shared.symlink_to(tmp_path)
    assert slots.slots_folder().is_relative_to(tmp_path / "runtime")
    held = take_slot()
    assert held.info.folder.startswith(str(tmp_path / "runtime"))
    held.release()


def test_a_folder_that_the_last_holder_removes_while_it_is_looked_at_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, removed = tmp_path / "slots", list[Path]()
    mkdir = Path.mkdir

    def made_and_removed(path: Path, *given: Any, **named: Any) -> None:
        mkdir(path, *given, **named)
        if path == root and not removed:
            removed.append(path)
            path.rmdir()

    monkeypatch.setattr(Path, "mkdir", made_and_removed)
    held = take_slot(root)
    assert Path(held.info.folder).is_relative_to(root)
    held.release()
    assert removed


def test_a_folder_for_slots_below_one_that_is_not_there_is_made(tmp_path: Path) -> None:
    take_slot(tmp_path / "a" / "b" / "slots").release()
