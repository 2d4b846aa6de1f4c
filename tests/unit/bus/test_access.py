"""What a router lets keys ask: only what the books answer, in threads of ours."""

from __future__ import annotations

from saflite.bus.access import BY, ROLES, Peer, access_control


def test_a_key_asks_nothing_that_zenoh_answers_by_itself() -> None:
    """Zenoh's threads read all links; one that answers waits for whoever asked and does not read, and all with it."""
    peers = [Peer(name=role, roles=(role,), common_name=f"{role}~{number:016x}") for number, role in enumerate(ROLES)]
    rules = [rule for rule in access_control(peers)["rules"] if not rule["id"].startswith("socket:")]
    asked = {key for rule in rules if "query" in rule["messages"] for key in rule["key_exprs"]}
    assert len(asked) > len(ROLES)
    assert [key for key in asked if not key.startswith(f"{BY}/")] == []
