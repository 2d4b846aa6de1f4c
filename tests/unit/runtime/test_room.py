"""A full disk is said before anything has to be saved."""

from __future__ import annotations

from pathlib import Path

import pytest

from saflite.bus.memory import MemoryNetwork
from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.contract.control import Answer
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime.books_service import TROUBLE_S, BooksService
from saflite.runtime.room import BYTES_MIN, LOOK_S, Room

CAMPAIGN = load_campaign("avoidance-m2")


class _Disk:
    def __init__(self, room: int | None) -> None:
        self.room, self.looks = room, 0

    def room_bytes(self) -> int | None:
        self.looks += 1
        return self.room


@pytest.mark.parametrize(("room", "full"), [(0, True), (BYTES_MIN - 1, True), (BYTES_MIN, False), (None, False)])
def test_it_is_full_where_little_is_left(room: int | None, full: bool) -> None:
    assert bool(Room(_Disk(room)).trouble(1.0)) is full


def test_it_is_looked_at_twice_a_second() -> None:
    room = Room(disk := _Disk(2**30))
    for tick in range(40):
        room.trouble(1.0 + 0.1 * tick)
    assert disk.looks == pytest.approx(4.0 / LOOK_S, abs=1)


class _Clock:
    now_s = 1000.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return 1.7e9 + self.now_s


def test_the_status_says_so_and_no_more_when_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, clock = Store.create(tmp_path / "run", CAMPAIGN, template(CAMPAIGN), describe()), _Clock()
    assert (store.room_bytes() or 0) > BYTES_MIN
    books = store.rebuild()
    books.begin(clock.now_s, clock.unix_s())
    service = BooksService(MemoryNetwork().connect("books"), CAMPAIGN.name, books, store, clock)

    def trouble() -> str:
        clock.now_s += LOOK_S
        service.step(0.0)
        status = service._with_own(Answer(accepted=True, status=books.status(clock.now_s)), clock.now_s).status
        return status.trouble if status else ""

    assert trouble() == ""
    with monkeypatch.context() as patched:
        patched.setattr(store, "room_bytes", lambda: 4096)
        assert trouble() == "the disk of the run is full: 4096 bytes are left"
    clock.now_s += TROUBLE_S
    assert trouble() == ""
    store.close()
