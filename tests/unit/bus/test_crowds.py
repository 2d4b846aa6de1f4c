"""A key has so many connections and no more."""

from __future__ import annotations

from saflite.bus.crowds import LINKS_MAX, surplus
from saflite.bus.links import SESSIONS_MAX
from saflite.campaign.engine.worker_registry import WORKERS_MAX


def test_what_is_too_much_is_counted_by_key_whatever_its_certificate() -> None:
    links = [(f"lab~{number:016x}", f"tls/10.0.0.1:{40_000 + number}") for number in range(5)]
    links += [("eve~0", "tls/[2001:db8::1]:1"), ("eve~0", "tls/[fe80::1%2]:2"), ("", "unixsock-stream/x")] * 2
    assert surplus(links, 3) == {
        "lab": [("10.0.0.1", 40_003), ("10.0.0.1", 40_004)],
        "eve": [("fe80::1", 2)],
    }
    assert surplus(links, 5) == {}
    assert len(surplus(links, 5, {"lab"})["lab"]) == 5, "all of it"


def test_a_key_may_have_all_workers_of_a_farm_and_leaves_room_for_others() -> None:
    assert WORKERS_MAX < LINKS_MAX <= SESSIONS_MAX / 2
