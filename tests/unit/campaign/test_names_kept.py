"""A restart of the books gives no worker's name to the key of another, before or after it joins again."""

from __future__ import annotations

from pathlib import Path

import pytest
from books_drive import doubles

from saflite.campaign.engine.core import MEMBERS_MAX
from saflite.campaign.engine.state import Books
from saflite.campaign.storage.store import Store
from saflite.contract.join import Join
from saflite.contract.topics import PROTOCOL


def card(worker: str, session: str = "new") -> Join:
    return Join(protocol=PROTOCOL, worker=worker, stage="fly", session=session)


def restarted(run_dir: Path, *, snapshot: bool) -> tuple[Books, Store]:
    """Return books that three workers had joined before they were killed: the user's own, lab's, and one that left."""
    store = Store.create(run_dir, doubles.campaign(20), doubles.TEMPLATE, doubles.TARGET)
    books = store.rebuild()
    books.begin(100.0, 1.7e9)
    for worker, owner in (("lab-0a1b2c-fly-1", ""), ("lab-fly-1", "lab"), ("lab-fly-2", "lab")):
        assert not books.join(card(worker, "old"), 100.0, owner=owner)
    books.absent("lab-fly-2", "fly", 101.0, session="old")
    store.commit(books.drain())
    if snapshot:
        store.keep(books.snapshot())
    store.close()
    store = Store.open(run_dir)
    books = store.rebuild()
    books.begin(200.0, 1.8e9)
    return books, store


@pytest.mark.parametrize("snapshot", [False, True])
def test_a_name_is_kept_for_whose_it_was(snapshot: bool, tmp_path: Path) -> None:
    books, store = restarted(tmp_path / "run", snapshot=snapshot)
    assert "is kept" in books.join(card("lab-0a1b2c-fly-1"), 200.0, owner="lab")
    assert books.owner_of("lab-0a1b2c-fly-1") == "", "so lab's key speaks for it in nothing"
    assert books.owner_of("lab-fly-1") == "lab"
    assert books.owner_of("lab-fly-2") is None
    assert not books.join(card("lab-fly-1"), 200.0, owner="lab")
    assert not books.join(card("lab-fly-2"), 200.0, owner="lab")
    assert not books.join(card("lab-0a1b2c-fly-1"), 200.0)
    books.absent("lab-0a1b2c-fly-1", "fly", 201.0, session="new")
    assert not books.join(card("lab-0a1b2c-fly-1"), 202.0, owner="lab"), "it has left: the name is free"
    store.close()


def test_the_farms_own_user_may_have_any_name(tmp_path: Path) -> None:
    books, store = restarted(tmp_path / "run", snapshot=False)
    assert not books.join(card("lab-fly-1"), 200.0)
    store.close()


def test_no_number_of_restarts_lets_names_pile_up(tmp_path: Path) -> None:
    books, store = restarted(tmp_path / "run", snapshot=False)
    for number in range(MEMBERS_MAX + 5):
        books._registry._workers.clear()
        books._registry._named.clear()
        assert not books.join(card(f"w-{number}"), 200.0)
    assert len(books._core.members) == MEMBERS_MAX
    assert "w-5" in books._core.members
    store.close()
