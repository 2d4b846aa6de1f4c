"""Carrying a campaign's events to a webhook: over restarts of the farm, of the receiver and of this bridge."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import msgspec

from saflite.campaign.storage.own_folder import check_closed
from saflite.console.io import farm_options
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.embargo import for_others
from saflite.console.run_data.run_folder import open_run
from saflite.contract.cloud_event import told_as
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import CampaignChanged, Event, kind_of
from saflite.contract.ids import short_id
from saflite.runtime.client import FarmClient
from saflite.runtime.clock import WallClock
from saflite.runtime.webhook import Cursor, Webhook, keep_cursor, read_cursor, read_secret

log = logging.getLogger(__name__)

AWAY_S = 1.0  # between looks for a farm that is away
ANSWER_S = 5.0


class Bridge(NamedTuple):
    """What goes where: the kinds of events told (all if empty), the receiver, and the file that says how far it is."""

    kinds: frozenset[str]
    webhook: Webhook
    cursor_file: Path


def run(args: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Carry events until the campaign ends."""
    clock = WallClock()
    secret = read_secret(args.secret) if args.secret is not None else b""
    webhook = Webhook(args.webhook, clock, secret)
    if not args.connect:
        args.run = farm_lookup.newest(args.run)
    bridge = Bridge(frozenset(args.kind), webhook, _cursor_file(args))
    cursor = read_cursor(bridge.cursor_file)
    if cursor is not None and cursor.covers(bridge.kinds):
        say(f"going on after event {cursor.seq}; {bridge.cursor_file}")
    elif cursor is not None:
        say(f"from the first event on: only {', '.join(cursor.kinds)} was told before; {bridge.cursor_file}")
    try:
        while not _carry(args, bridge):
            clock.sleep_s(AWAY_S)
    finally:
        webhook.close()


def _cursor_file(args: argparse.Namespace) -> Path:
    if args.cursor is not None:
        return Path(args.cursor)
    if args.connect:
        raise Refused("--cursor", expected="a file that keeps how far it is, with --connect", got="nothing")
    check_closed(args.run)
    return Path(args.run) / f"webhook-{short_id(args.webhook.encode())[:8]}.json"


def _carry(args: argparse.Namespace, bridge: Bridge) -> bool:
    """Carry what can be had now; True if the campaign has ended: by its books, however much of it was told before."""
    try:
        if args.connect or farm_lookup.says_it_runs(args.run):
            return _carry_from_farm(args, bridge)
        with open_run(args.run) as folder:
            cursor = _at(bridge, folder.campaign.name, lambda seq: next(folder.events(seq), None))
            if cursor is not None:
                _tell(bridge, cursor, folder.events(cursor.seq + 1))
            changes = folder.facts(CampaignChanged)
            return bool(changes) and changes[-1].state == "ended"
    except Unavailable as fault:
        log.info("the farm is away: %s", fault)
        return False


def _carry_from_farm(args: argparse.Namespace, bridge: Bridge) -> bool:
    client = _connected(args)
    try:
        cursor = _at(bridge, client.campaign, client.event)
        if cursor is not None:
            _tell(bridge, cursor, client.watch(cursor.seq + 1, patience_s=ANSWER_S))
        return cursor is not None  # what is watched has come to its end
    finally:
        client.close()


def _tell(bridge: Bridge, cursor: Cursor, events: Iterable[Event]) -> None:
    """Have the receiver take the events of the kinds asked for."""
    for event in events:
        if not bridge.kinds or kind_of(event.fact) in bridge.kinds:
            bridge.webhook.deliver(for_others(event), cursor)
            keep_cursor(bridge.cursor_file, _after(cursor, event))


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
    """Return how far this run was told, None if it has no events; another run of the same name begins anew.

    So does one of which not all kinds asked for were told, and one whose event told last is another now, or is not
    there: commits were lost, and their numbers are given again. What is told twice bears the same id, what differs
    another.
    """
    first = event(1)
    if first is None:
        return None
    kinds = tuple(sorted(bridge.kinds))
    begun, kept = Cursor(campaign=campaign, begun_unix_s=first.at_unix_s, kinds=kinds), read_cursor(bridge.cursor_file)
    if kept is None or not kept.covers(bridge.kinds):
        return begun
    kept = msgspec.structs.replace(kept, kinds=kinds)
    if msgspec.structs.replace(kept, seq=0, told_as="") != begun:
        return begun
    last = event(kept.seq) if kept.told_as else None
    return kept if not kept.told_as or (last is not None and told_as(last) == kept.told_as) else begun
