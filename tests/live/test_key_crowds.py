"""A key that opens ever more connections, or asks of ever more names: it keeps its share, and others keep theirs."""

from __future__ import annotations

import threading
import time

import pytest
from test_keys import CAMPAIGN, PATIENCE_S, Router, _asked, router  # noqa: F401 (fixture)

from saflite.bus.access import ACCESS_KEY, BY
from saflite.contract import topics

pytestmark = pytest.mark.live


def test_a_key_has_no_more_connections_than_its_share_and_others_keep_theirs(
    router: Router,  # noqa: F811
) -> None:
    other, crowd = router.client("operator"), [router.client("scorer") for _ in range(6)]
    session = router.bus._session
    try:
        assert router.bus.end_surplus(6) == {}
        assert router.bus.end_surplus(3) == {"scorer": 3}
        until_s = time.monotonic() + PATIENCE_S
        ended: dict[str, int] = {}
        while sum("scorer~" in str(link.auth_identifier) for link in session.info.links()) > 3:
            ended = router.bus.end_surplus(3)  # they come back, and are ended again
            assert time.monotonic() < until_s, ended
        assert router.bus.end_surplus(6, {"scorer"})["scorer"] > 0
        key = topics.control(CAMPAIGN, "status")
        assert _asked(other, key, b"x").payload == b"operator"
    finally:
        for bus in (other, *crowd):
            bus.close()


def test_who_asks_what_any_names_may_costs_no_thread_for_each(router: Router) -> None:  # noqa: F811
    """Whoever has a certificate may ask that, a revoked one, too: each name had a thread of its own, for good."""
    bus = router.client("gone")
    assert bus.access()
    before = _threads_that_send()
    for number in range(50):
        assert list(bus._session.get(f"{BY}/name-{number}/{ACCESS_KEY}", timeout=PATIENCE_S)), "it is told"
    bus.close()
    assert _threads_that_send() == before


def _threads_that_send() -> set[str]:
    return {thread.name for thread in threading.enumerate() if thread.name.startswith("send-")}
