"""A farm that takes keys, and those without the right one: what they forge must not be taken.

`eve` has a key of the farm, so that the router connects her, and knows what `alice` works on; she does not have alice's
key. Strangers have no certificate of the farm at all. The books and the router are the real ones.
"""

from __future__ import annotations

import queue
import socket
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from saflite.bus import keyring
from saflite.bus.base import Reply, seal
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.zenoh import Gate, ZenohBus, leave_process, open_client, open_router
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.contract import topics, wire
from saflite.contract.blobs import BlobOpen, BlobPut, ref_of
from saflite.contract.config import Campaign, LeaseConfig
from saflite.contract.control import Control
from saflite.contract.errors import FarmError
from saflite.contract.join import Join, Joined
from saflite.contract.rng import derive
from saflite.contract.work import Ask, Grant, Heartbeat, Lease, MutateResult, Receipt, Report
from saflite.runtime.books_service import BooksService
from saflite.runtime.clock import WallClock
from saflite.runtime.software import card_of
from saflite.simulator_worker.registry import describe_target

NAME = "forged"
WAIT_S = 3.0
BATCH = 250
STRANGERS = 20


class Forged(NamedTuple):
    """A message that must not be taken: the key it goes to, the name in that key (None: eve's own), the bytes."""

    key: str
    under: str | None
    payload: bytes


class KeyedFarm:
    """The books of a campaign on a router that takes keys, with `alice` and `eve` registered as mutators."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.clock = folder, WallClock()
        self.keys = folder / "keys"
        keyring.init(self.keys, [], now_s=self.clock.unix_s())
        for name in ("alice", "eve"):
            keyring.add(self.keys, name, ["mutator"], now_s=self.clock.unix_s())
        campaign = Campaign(name=NAME, mission="mission1", budget_flights=5, lease=LeaseConfig(lease_s=600.0))
        self.store = Store.create(folder / "run", campaign, template(campaign), describe_target("reference"))
        self.books = self.store.rebuild()
        self.books.begin(self.clock.monotonic_s(), self.clock.unix_s())
        self.private = PrivateSocket()
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.endpoint = f"tls/127.0.0.1:{probe.getsockname()[1]}"
        gate = Gate(
            self.endpoint, keyring.farm_credentials(self.keys, self.clock.unix_s()), keyring.read_register(self.keys)
        )
        self.bus = open_router("books", self.private.endpoint, gate=gate)
        self.service = BooksService(self.bus, NAME, self.books, self.store, self.clock)
        self._thread = threading.Thread(target=self.service.run, name="books", daemon=True)
        self._thread.start()

    def client(self, name: str) -> ZenohBus:
        """Return a bus with the key of a name."""
        credentials = keyring.peer_credentials(self.keys / "peers" / name, self.clock.unix_s())
        return open_client(name, self.endpoint, patience_s=6.0, keys=credentials)

    def close(self) -> None:
        """End everything."""
        self.service.stop("done")
        self._thread.join(10.0)
        self.bus.close()
        self.private.close()
        self.store.close()


def forgeries(count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Send `count` forged messages; return how many were sent and taken, and what became of alice's own."""
    with tempfile.TemporaryDirectory(prefix="saflite-forgers-") as folder:
        farm = KeyedFarm(Path(folder))
        try:
            return _forgeries(farm, count, rng)
        finally:
            farm.close()


def _forgeries(farm: KeyedFarm, count: int, rng: np.random.Generator) -> dict[str, Any]:
    alice, eve = farm.client("alice"), farm.client("eve")
    card = card_of("mutate", "alice-1", farm.clock)
    assert _one(alice, topics.join(NAME, "mutate"), card, Joined).accepted
    ask = Ask(worker="alice-1", stage="mutate", session=card.session, wait_s=0.0)
    (lease,) = _one(alice, topics.work(NAME, "mutate"), ask, Grant).leases
    makers = list(_makers(lease, card, farm, rng))
    sent, taken = Counter[str](), Counter[str]()
    for first in range(0, count, BATCH):
        batch = [makers[place % len(makers)] for place in range(first, min(first + BATCH, count))]
        forged = [(name, make()) for name, make in batch]
        sent.update(name for name, _ in forged)
        taken.update(_taken(eve, forged))
    result = MutateResult(round=0, test_cases=())
    report = Report(worker="alice-1", lease_id=lease.lease_id, epoch=lease.epoch, result=result)
    receipt = _one(alice, topics.result(NAME, "mutate"), report, Receipt)
    alice.close()
    eve.close()
    strangers = sum(_is_let_in(farm, number) for number in range(STRANGERS))
    return {
        "sent": sent.total(),
        "taken": taken.total() + strangers,
        "taken_by_kind": dict(taken),
        "strangers_tried": STRANGERS,
        "strangers_let_in": strangers,
        "own_result_after_them": receipt.status,
    }


def _makers(
    lease: Lease, card: Join, farm: KeyedFarm, rng: np.random.Generator
) -> Iterator[tuple[str, Callable[[], Forged]]]:
    """Yield makers of forged messages by name: each in alice's name on eve's key, on alice's, and on none."""
    report = {"worker": "alice-1", "lease_id": lease.lease_id, "epoch": lease.epoch}
    ref = ref_of(b"forged")
    said: dict[str, tuple[str, Callable[[], bytes]]] = {
        "result": (
            topics.result(NAME, "mutate"),
            lambda: _result(report, {"type": "mutated", "round": 0, "test_cases": []}),
        ),
        "handed back": (topics.result(NAME, "mutate"), lambda: _result(report, {"type": "handed_back"})),
        "failure": (topics.result(NAME, "mutate"), lambda: _result(report, {"type": "failed", "message": "x"})),
        "unreadable": (topics.result(NAME, "mutate"), lambda: _result(report, int(rng.integers(2**31)))),
        "join": (
            topics.join(NAME, "mutate"),
            lambda: wire.encode(msgspec.structs.replace(card, session=f"s{rng.integers(2**31)}")),
        ),
        "ask": (
            topics.work(NAME, "mutate"),
            lambda: wire.encode(Ask(worker="alice-1", stage="mutate", session=card.session, wait_s=0.0)),
        ),
        "beat": (
            topics.beat(NAME, "mutate"),
            lambda: wire.encode(Heartbeat(worker="alice-1", stage="mutate", session=card.session)),
        ),
        "blob put": (topics.blob(NAME, "put"), lambda: wire.encode(BlobPut(worker="alice-1", ref=ref, data=b"forged"))),
        "blob open": (topics.blob(NAME, "open"), lambda: wire.encode(BlobOpen(worker="alice-1"))),
        "flight": (topics.result(NAME, "fly"), lambda: _result(report, {"type": "failed", "message": "x"})),
        "pause": (topics.control(NAME, "pause"), lambda: wire.encode(Control(verb="pause"))),
        "stop": (topics.control(NAME, "stop"), lambda: wire.encode(Control(verb="stop"))),
        "budget": (topics.control(NAME, "budget"), lambda: wire.encode(Control(verb="budget", number=10**6))),
        "scorer": (topics.control(NAME, "scorer"), lambda: wire.encode(Control(verb="scorer", text="random"))),
    }
    for name, (key, make) in said.items():
        for under in (None, "alice", ""):
            yield f"{name} {_where(under)}", _maker(key, under, make)


def _maker(key: str, under: str | None, make: Callable[[], bytes]) -> Callable[[], Forged]:
    return lambda: Forged(key, under, make())


def _where(under: str | None) -> str:
    return {None: "under her own key", "": "under no key"}.get(under, f"under the key of {under}")


def _result(report: dict[str, Any], result: Any) -> bytes:
    return msgspec.msgpack.encode({**report, "result": result})


def _taken(eve: ZenohBus, forged: list[tuple[str, Forged]]) -> Counter[str]:
    inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
    for place, (_, one) in enumerate(forged):
        eve._peer = "eve" if one.under is None else one.under
        eve.ask(one.key, one.payload, place, inbox.put, WAIT_S, attachment=seal(one.key, "alice", one.payload))
    eve._peer = "eve"
    replies: list[Reply] = [inbox.get(timeout=10.0 * WAIT_S) for _ in forged]
    return Counter(forged[int(str(reply.tag))][0] for reply in replies if reply.payload is not None)


def _one(bus: ZenohBus, key: str, message: msgspec.Struct, kind: type[Any]) -> Any:
    inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
    bus.ask(key, wire.encode(message), 0, inbox.put, 20.0)
    reply = inbox.get(timeout=30.0)
    assert reply.payload is not None, f"no answer to {message}: {reply.refused}"
    return wire.decode(reply.payload, kind)


def _is_let_in(farm: KeyedFarm, number: int) -> bool:
    """Return whether somebody with a certificate of another farm can open a session."""
    other = farm.folder / f"other-{number}"
    keyring.init(other, [], now_s=farm.clock.unix_s())
    bundle = keyring.add(other, "alice", ["operator"], now_s=farm.clock.unix_s())
    if number % 2:  # trusting this farm's router, so that only the router can refuse
        (bundle / "ca.pem").write_bytes((farm.keys / "farm" / "ca.pem").read_bytes())
    try:
        credentials = keyring.peer_credentials(bundle, farm.clock.unix_s())
        bus = open_client("alice", farm.endpoint, patience_s=2.0, keys=credentials)
    except FarmError:
        return False
    bus.close()
    return True


if __name__ == "__main__":
    print(forgeries(int(sys.argv[1]), derive(1, "forgers")))
    sys.stdout.flush()
    leave_process(0)
