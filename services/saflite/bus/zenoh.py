"""The bus on Zenoh. Nothing outside this folder imports `zenoh`.

A star: the process of the books holds the router, everybody else is a client of it. Multicast scouting and gossip
are off, so two farms on one network never meet by accident. Zenoh's own threads only append to the inboxes.
"""

from __future__ import annotations

import json
import logging
import os
import threading
from collections.abc import Callable, Collection, Hashable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple, NoReturn

import zenoh
from zenoh import ext

from saflite.bus.access import ACCESS_KEY, BY, Peer, access_control, in_words, size_limits, split
from saflite.bus.base import Inbox, Presence, Sample, seal, unseal
from saflite.bus.crowds import shut, surplus
from saflite.bus.endpoints import check_endpoint
from saflite.bus.keyring import Credentials, Register
from saflite.bus.links import ROUTER_THREADS, config_of, gate_settings
from saflite.bus.memory import HISTORY
from saflite.bus.questions import Question, ZenohRequest, attached, end_of
from saflite.bus.reach import TRY_FIRST_S, TRY_MAX_S, attempts, why_unreached
from saflite.bus.sending import Senders
from saflite.bus.sockets import end_at_once, keep_ending_at_once
from saflite.contract import topics
from saflite.contract.config import environment, set_environment
from saflite.contract.errors import Unavailable

log = logging.getLogger(__name__)

CLOSE_LIMIT_S = 3.0
ACCESS_S = 2.0
FACTS = "/facts"  # the line of what is announced; no key can have this name
SAID_OF_KEYS = "/access"  # the line of what keys may do: who asks for that, of any name, has proven none
HEARTBEAT_S = 0.5  # how often an announcer says how far it is, so that followers notice a lost last fact


class ZenohBus:
    """One participant's end of the bus: a Zenoh session and what it declared.

    `peer` is whose certificate it shows, None without one. A router that `admits` such participants serves their
    keys beside its own. `connect` opens another session like this one; a router has none.
    """

    def __init__(
        self,
        name: str,
        session: zenoh.Session,
        *,
        peer: Peer | None = None,
        admits: bool = False,
        connect: Callable[[], zenoh.Session] | None = None,
    ) -> None:
        self.name, self._peer, self._admits = name, peer.name if peer else "", admits
        self._shown, self._may = (peer.shown, peer.in_words()) if peer else ("", "")
        self._session, self._connect = session, connect
        self._senders = Senders()
        self._changing, self.closed = threading.Lock(), threading.Event()
        self._announcers: dict[str, Any] = {}
        self._tellers: dict[str, Any] = {}
        self._declarations: list[Callable[[zenoh.Session], Any]] = []
        self._declared: list[Any] = []

    def serve(self, pattern: str, inbox: Inbox) -> None:
        """See `Bus.serve`."""
        handler = _direct(lambda query: inbox(ZenohRequest(query, self.name, self._senders)))
        for served in (pattern, f"{BY}/*/{pattern}") if self._admits else (pattern,):
            self._declare(partial(_queryable, served, handler))

    def ask(
        self,
        key: str,
        payload: bytes,
        tag: Hashable,
        inbox: Inbox,
        timeout_s: float,
        *,
        attachment: bytes | None = None,
    ) -> None:
        """See `Bus.ask`. `attachment` is for tests that send a seal which does not fit."""
        question = Question(tag, inbox)
        bytes_max = topics.bytes_max(key)
        if len(payload) > bytes_max:  # the router would drop it without a word
            question.refuse(f"message: expected at most {bytes_max} bytes on {key}, got {len(payload)}")
            return
        try:
            self._session.get(
                f"{BY}/{self._peer}/{key}" if self._peer else key,
                _direct(question.on_reply, question.on_drop),
                target=zenoh.QueryTarget.BEST_MATCHING,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s,
                payload=payload,
                attachment=attachment if attachment is not None else seal(key, self.name, payload),
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
        except zenoh.ZError as fault:
            log.warning("question on %s not sent: %s", key, fault)
            question.on_drop()

    def tell_access(self, register: Register) -> None:
        """Tell whoever has a certificate what its name may do: denials themselves are silent."""

        def tell(query: zenoh.Query) -> None:
            asked, shown = split(str(query.key_expr))[0], query.payload.to_bytes() if query.payload is not None else b""
            words = in_words(register.named(asked), asked, shown.decode(errors="replace") or asked).encode()
            say = partial(end_of, query, lambda query: query.reply(query.key_expr, words), ACCESS_KEY)
            self._senders.send(SAID_OF_KEYS, len(words), say)

        self._declare(partial(_queryable, f"{BY}/*/{ACCESS_KEY}", _direct(tell)))

    def access(self) -> str:
        """Return in words what this participant may do, empty where nobody says."""
        key, shown = f"{BY}/{self._peer}/{ACCESS_KEY}", self._shown
        for reply in self._session.get(key, payload=shown, timeout=ACCESS_S) if self._peer else ():
            if reply.ok is not None:
                return reply.ok.payload.to_bytes().decode(errors="replace")[:500]
        return ""

    def denied(self) -> str:
        """Return in words why this participant's key gets nothing; empty where it counts, or nobody says."""
        try:
            said = self.access()
        except zenoh.ZError:  # its link is gone
            return ""
        return "" if said == self._may else said

    def end_surplus(self, most: int, none_of: Collection[str] = ()) -> dict[str, int]:
        """End the connections that a key has beyond so many, all of some keys; return how many those were, by key.

        For a router. Who was ended may connect again.
        """
        links = ((link.auth_identifier or "", link.dst) for link in self._session.info.links())
        return {key: shut(ends) for key, ends in surplus(links, most, none_of).items()}

    def announce(self, key: str, payload: bytes) -> None:
        """See `Bus.announce`. A follower whose link is full is left out; it asks for what it missed."""
        self._publish(len(payload), lambda: self._announce(key, payload))

    def _publish(self, size_bytes: int, act: Callable[[], None]) -> None:
        """Publish; a router with a gate does so by a thread of its own: a follower may not read."""
        if not self._admits:
            act()
        elif not self._senders.send(FACTS, size_bytes, act):
            log.warning("facts not announced: too many wait; followers ask for them")

    def _announce(self, key: str, payload: bytes) -> None:
        if key not in self._announcers:
            self._announcers[key] = ext.declare_advanced_publisher(
                self._session,
                key,
                congestion_control=zenoh.CongestionControl.DROP if self._admits else zenoh.CongestionControl.BLOCK,
                express=True,
                cache=ext.CacheConfig(HISTORY),
                sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S),
                publisher_detection=True,
            )
        self._announcers[key].put(payload, attachment=seal(key, self.name, payload))

    def tell(self, key: str, payload: Callable[[], bytes]) -> None:
        """See `Bus.tell`."""
        self._publish(0, lambda: self._tell(key, payload))

    def _tell(self, key: str, payload: Callable[[], bytes]) -> None:
        if key not in self._tellers:
            self._tellers[key] = self._session.declare_publisher(key, express=True)
        if self._tellers[key].matching_status.matching:
            data = payload()
            self._tellers[key].put(data, attachment=seal(key, self.name, data))

    def follow(self, pattern: str, inbox: Inbox) -> None:
        """See `Bus.follow`. A fact damaged on its way is left out.

        Who shows a certificate is given no past (`bus/access.py`): the books tell that, on `control/events`.
        """

        def on_sample(sample: zenoh.Sample) -> None:
            key, payload = str(sample.key_expr), sample.payload.to_bytes()
            if not unseal(key, attached(sample), payload)[1]:
                inbox(Sample(key, payload))

        if self._peer:
            self._declare(lambda session: session.declare_subscriber(pattern, _direct(on_sample)))
            return
        self._declare(
            lambda session: ext.declare_advanced_subscriber(
                session,
                pattern,
                _direct(on_sample),
                history=ext.HistoryConfig(detect_late_publishers=True, max_samples=HISTORY),
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )
        )

    def appear(self, key: str) -> None:
        """See `Bus.appear`."""
        self._declare(lambda session: session.liveliness().declare_token(key))

    def watch(self, pattern: str, inbox: Inbox) -> None:
        """See `Bus.watch`."""
        handler = _direct(
            lambda sample: inbox(Presence(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)),
        )
        self._declare(lambda session: session.liveliness().declare_subscriber(pattern, handler, history=True))

    def renew(self) -> None:
        """See `Bus.renew`. The old session goes first, so that who watches its tokens sees them come last."""
        if self._connect is None or not self._changing.acquire(blocking=False):
            return
        try:
            session = self._connect()
            old, self._session = self._session, session
            end_at_once(())
            _close(old)
            self._announcers.clear()
            self._tellers.clear()
            self._declared = [declare(session) for declare in self._declarations]
            if self.closed.is_set():
                _close(session)
        except zenoh.ZError as fault:
            log.warning("no new link to the router: %s", _words(fault))
        finally:
            self._changing.release()

    def close(self) -> None:
        """See `Bus.close`."""
        self.closed.set()
        self._senders.close()
        _close(self._session)

    def _declare(self, declare: Callable[[zenoh.Session], Any]) -> None:
        self._declarations.append(declare)
        self._declared.append(declare(self._session))


def _queryable(pattern: str, handler: Any, session: zenoh.Session) -> Any:
    return session.declare_queryable(pattern, handler, complete=True)


def _close(session: zenoh.Session) -> None:
    closer = threading.Thread(target=session.close, daemon=True)
    closer.start()
    closer.join(CLOSE_LIMIT_S)
    if closer.is_alive():
        log.warning("zenoh session did not close within %.0f s; left behind", CLOSE_LIMIT_S)


def _direct(callback: Callable[[Any], None], drop: Callable[[], None] | None = None) -> Any:
    """Return a handler run on Zenoh's own thread; the default would start a Python thread per question."""
    return zenoh.handlers.Callback(callback, drop, indirect=False)


def _words(fault: zenoh.ZError) -> str:
    """Return the fault without the source line Zenoh appends."""
    return str(fault).partition(" at /")[0]


def _open(config: dict[str, Any]) -> zenoh.Session:
    settings = zenoh.Config()
    for key, value in config.items():
        settings.insert_json5(key, json.dumps(value))
    return zenoh.open(settings)


class Gate(NamedTuple):
    """A second place where a router listens, for those who prove their name; `register` says what they may do."""

    endpoint: str
    credentials: Credentials
    register: Register


def open_router(name: str, endpoint: str, *, insecure: bool = False, gate: Gate | None = None) -> ZenohBus:
    """Return a bus that is also the router everybody connects to.

    Raises:
        Refused: others can reach the endpoint and `insecure` does not allow that.
        Unavailable: it cannot listen there.
    """
    places = [check_endpoint(endpoint, insecure=insecure, argument="--listen").text]
    more: dict[str, Any] = {"low_pass_filter": size_limits()}
    if gate is not None:
        places.append(check_endpoint(gate.endpoint, insecure=False, keys=True, argument="--listen").text)
        more |= gate_settings()
        more["transport/link/tls"] = gate.credentials.tls()
        more["access_control"] = access_control(gate.register.peers)
    set_environment("ZENOH_RUNTIME", environment("ZENOH_RUNTIME", ROUTER_THREADS))  # for a process's first session
    try:
        with _private_files():
            session = _open({**config_of("router", *places), **more})
    except zenoh.ZError as fault:
        raise Unavailable(f"cannot listen on {' and '.join(places)}: {_words(fault)}") from fault
    bus = ZenohBus(name, session, admits=gate is not None)
    keep_ending_at_once(bus.closed)
    if gate is not None:
        bus.tell_access(gate.register)
    return bus


def open_client(
    name: str,
    endpoint: str,
    *,
    patience_s: float | None = None,
    insecure: bool = False,
    keys: Credentials | None = None,
) -> ZenohBus:
    """Return a bus connected to the router at `endpoint`; tries for `patience_s`, or without end, and says so.

    Raises:
        Refused: it needs keys, or others can reach the endpoint and `insecure` does not allow that.
        Unavailable: the router was not reached within `patience_s`.
    """
    place = check_endpoint(endpoint, insecure=insecure, keys=keys is not None)
    config = config_of("client", place.text)
    if keys is not None:
        config["transport/link/tls"] = keys.tls()
    spent_s, limit_s = 0.0, float("inf") if patience_s is None else patience_s
    for attempt in attempts(name, TRY_FIRST_S if keys is None else TRY_MAX_S):
        try_s = min(attempt.try_s, limit_s)
        config["connect/timeout_ms"] = round(1000 * try_s)
        spent_s += try_s
        try:
            peer = keys.peer if keys is not None else None
            return ZenohBus(name, _open(config), peer=peer, connect=partial(_open, config))
        except zenoh.ZError as fault:
            over = spent_s >= limit_s
            why = (why_unreached(place, keys) if over or attempt.worth_a_look else "") or _words(fault)
            if over:
                raise Unavailable(f"no router at {endpoint} (tried {attempt.number} times): {why}") from fault
            log.warning("no router at %s yet (try %d), trying on: %s", endpoint, attempt.number, why)
            threading.Event().wait(attempt.pause_s)
            spent_s += attempt.pause_s
    raise AssertionError("attempts do not end")


@contextmanager
def _private_files() -> Iterator[None]:
    """Have the socket made so that only this user can connect, whatever folder it lies in."""
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)


def leave_process(code: int) -> NoReturn:
    """End the process without waiting for Zenoh's threads, which may hang at exit."""
    logging.shutdown()
    os._exit(code)
