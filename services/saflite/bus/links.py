"""With which settings Zenoh's sessions are opened: who listens and connects where, what a link does that is full."""

from __future__ import annotations

from typing import Any, Literal

from saflite.bus.reach import TRY_FIRST_S
from saflite.contract.wire import MESSAGE_BYTES_MAX

LINK_LEASE_MS = 2000  # a frozen peer is noticed after about 0.75 of it; Zenoh's default of 10 s is too slow for us
SESSIONS_MAX, OPENING_MAX = 4_000, 1_000  # of a router; Zenoh's own 1,000 and 100 are less than may join at once
ANSWERS_WAIT_US = 50_000  # so long for a short one: a machine that is busy empties a link late, and Zenoh's own is 1 ms
FRAGMENTS_WAIT_US = 2_000_000  # so long a full link takes no more of a long answer before that is given up

ROUTER_THREADS = "(acc: (handover: rx), net: (handover: rx))"
"""Who reads what links bring also waits for it to come, and keeps the deadlines of questions: to wake another thread
for either costs as much as to read. Who sends stays apart: a full link must not keep others from being read."""


def config_of(mode: Literal["router", "client"], *endpoints: str) -> dict[str, Any]:
    """Return Zenoh's configuration: a router listening on `endpoints`, or a client connected to one."""
    return {
        "mode": mode,
        "listen/endpoints": list(endpoints) if mode == "router" else [],
        "connect/endpoints": [] if mode == "router" else list(endpoints),
        "connect/timeout_ms": round(1000 * TRY_FIRST_S),
        "connect/exit_on_failure": True,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LINK_LEASE_MS,
        "transport/link/rx/max_message_size": 2 * MESSAGE_BYTES_MAX,
        "transport/unicast/max_sessions": SESSIONS_MAX,
        "transport/unicast/accept_pending": OPENING_MAX,
        "transport/shared_memory/enabled": False,
        "timestamping/enabled": False,
    }


def gate_settings() -> dict[str, Any]:
    """Return what keeps a router from waiting for whoever asks over a gate and does not read the answers.

    Answers go as their question says, and a question may say that a full link is waited for, whoever else waits then.
    So the router takes all as saying that what a full link does not take is left out; it is asked for again.
    """
    questions = {"messages": ["query"], "flows": ["ingress"], "link_protocols": ["tls"], "key_exprs": ["**"]}
    drop = {"id": "drop", "overwrite": {"congestion_control": "drop"}, **questions}
    waits = "transport/link/tx/queue/congestion_control/drop"
    return {
        "qos/network": [drop],
        f"{waits}/wait_before_drop": ANSWERS_WAIT_US,
        f"{waits}/max_wait_before_drop_fragments": FRAGMENTS_WAIT_US,
    }
