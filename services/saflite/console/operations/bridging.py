"""Carrying a campaign's events to a webhook: over restarts of the farm, of the receiver and of this bridge."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Container, Iterable
from pathlib import Path

import msgspec

from saflite.campaign.storage.own_folder import check_run_closed
from saflite.console.io import farm_options
from saflite.console.operations import relaying
from saflite.console.operations.relaying import AWAY_S, Bridge, GivenUp, PatientClock, StoppableClock, place_in
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.embargo import for_others
from saflite.console.run_data.run_folder import open_run
from saflite.contract.cloud_event import told_as
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.contract.events import Event, ViolationFound, kind_of
from saflite.contract.ids import short_id
from saflite.runtime.client import ANSWER_S, FarmClient
from saflite.runtime.clock import WallClock
from saflite.runtime.waiting_events import WaitingEvents, waiting_file
from saflite.runtime.webhook import Cursor, WaitingClock, Webhook, keep_cursor, read_cursor, read_secret

__all__ = ["Bridge", "run"]


def run(args: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Carry events until the campaign ends and all are taken.

    Raises:
        Refused: the receiver, the farm or this machine says that it will never do.
        Unavailable: the farm at an endpoint has gone, and events may be missing; which, it says. Or the campaign has
            ended and the receiver stayed away; what it did not take and where that is, it says.
    """
    clock = WallClock()
    secret = read_secret(args.secret) if args.secret is not None else b""
    stopping = StoppableClock()
    if not args.connect:
        args.run = farm_lookup.newest(args.run)
    cursor_file, receiver_s = _cursor_file(args), args.receiver_patience or float("inf")
    patient = PatientClock(clock, lambda: _taken_at_end(args.run, cursor_file), receiver_s)
    webhook = Webhook(args.webhook, stopping if args.connect else patient, secret)
    bridge = Bridge(frozenset(args.kind), webhook, cursor_file, receiver_s)
    cursor = read_cursor(bridge.cursor_file)
    if cursor is not None and cursor.covers(bridge.kinds):
        say(f"going on after event {cursor.seq}; {bridge.cursor_file}")
    elif cursor is not None:
        say(f"from the first event on: only {', '.join(cursor.kinds)} was told before; {bridge.cursor_file}")
    try:
        if args.connect:
            _relay(args, bridge, stopping, say)
        else:
            _from_run(args, bridge, clock, say)
    finally:
        webhook.close()


def _relay(args: argparse.Namespace, bridge: Bridge, clock: StoppableClock, say: Callable[[str], None]) -> None:
    patience_s = args.patience or float("inf")
    relaying.relay(lambda: _connected(args), bridge, clock, say, patience_s)


def _taken_at_end(run_dir: Path, cursor_file: Path) -> int | None:
    """Return the last event taken of a run whose campaign has ended; None of another, and where that cannot be read."""
    try:
        with open_run(run_dir) as folder:
            if folder.standing().state != "ended":
                return None
        cursor = read_cursor(cursor_file)
    except FarmError:
        return None
    return 0 if cursor is None else cursor.seq


def _from_run(args: argparse.Namespace, bridge: Bridge, clock: WaitingClock, say: Callable[[str], None]) -> None:
    """Carry from a run folder, whose books keep all events; one that is neither over nor worked on is waited for."""
    if waiting_file(bridge.cursor_file).exists():  # of a bridge to its farm: the books hold these, too
        WaitingEvents(bridge.cursor_file, bridge.kinds).close(over=True)
    told = ""
    while True:
        words = ""
        try:
            if _carry(args, bridge):
                break
            if not farm_lookup.says_it_runs(args.run):
                words = f"{args.run} is not over and no farm works on it: its next events are waited for"
        except GivenUp as fault:
            raise Unavailable(relaying.untaken(_untaken(args.run, bridge), bridge, f"stay in {args.run}")) from fault
        except Unavailable as fault:
            words = f"nothing is told, and tried again: {fault}"
        if words and words != told:
            say(words)
        told = words or told
        clock.sleep_s(AWAY_S)
    cursor = read_cursor(bridge.cursor_file)
    if cursor is not None:  # a bridge to the farm that has gone need not look for it
        keep_cursor(bridge.cursor_file, msgspec.structs.replace(cursor, end=cursor.seq))


def _untaken(run_dir: Path, bridge: Bridge) -> int:
    cursor = read_cursor(bridge.cursor_file)
    with open_run(run_dir) as folder:
        events = folder.events(1 if cursor is None else cursor.seq + 1)
        return sum(1 for event in events if not bridge.kinds or kind_of(event.fact) in bridge.kinds)


def _cursor_file(args: argparse.Namespace) -> Path:
    if args.cursor is not None:
        return Path(args.cursor)
    if args.connect:
        raise Refused("--cursor", expected="a file that keeps how far it is, with --connect", got="nothing")
    check_run_closed(args.run)
    return Path(args.run) / f"webhook-{short_id(args.webhook.encode())[:8]}.json"


def _carry(args: argparse.Namespace, bridge: Bridge) -> bool:
    """Carry what can be had now; True if the campaign has ended: by its books, however much of it was told before.

    Raises Unavailable where the farm does not answer, or the disk fails.
    """
    if farm_lookup.says_it_runs(args.run):
        return _carry_from_farm(args, bridge)
    with open_run(args.run) as folder:
        ended = folder.standing().state == "ended"  # looked at first: more may come while the receiver is waited for
        cursor = _at(bridge, folder.campaign.name, lambda seq: next(folder.events(seq), None))
        if cursor is not None:
            # asked anew for each find: the run may be gone on with while the receiver is waited for
            _tell(bridge, cursor, folder.events(cursor.seq + 1), lambda: _memory_faults(args.run))
        return ended


def _carry_from_farm(args: argparse.Namespace, bridge: Bridge) -> bool:
    client = _connected(args)
    try:
        cursor = _at(bridge, client.campaign, client.event)
        if cursor is not None:
            events = client.watch(cursor.seq + 1, patience_s=ANSWER_S)
            _tell(bridge, cursor, events, lambda: _memory_faults(args.run))
        return cursor is not None  # what is watched has come to its end
    finally:
        client.close()


def _tell(bridge: Bridge, cursor: Cursor, events: Iterable[Event], memory_faults: Callable[[], Container[str]]) -> None:
    """Have the receiver take the events of the kinds asked for, of finds what may leave as the books have it now."""
    for event in events:
        if not bridge.kinds or kind_of(event.fact) in bridge.kinds:
            is_find = isinstance(event.fact, ViolationFound)
            bridge.webhook.deliver(for_others(event, memory_faults()) if is_find else event, cursor)
            keep_cursor(bridge.cursor_file, _after(cursor, event))


def _memory_faults(run_dir: Path) -> Container[str]:
    with open_run(run_dir) as folder:
        return folder.memory_faults()


def _connected(args: argparse.Namespace) -> FarmClient:
    try:
        return farm_lookup.connect(farm_options.where(args)._replace(run_dir=args.run))
    except Refused as fault:
        if args.connect or farm_lookup.says_it_runs(args.run):
            raise
        raise Unavailable(f"it has ended just now: {fault}") from fault


def _after(cursor: Cursor, event: Event) -> Cursor:
    return msgspec.structs.replace(cursor, seq=event.seq, told_as=told_as(event))


def _at(bridge: Bridge, campaign: str, event: Callable[[int], Event | None]) -> Cursor | None:
    return place_in(read_cursor(bridge.cursor_file), bridge.kinds, campaign, event)
