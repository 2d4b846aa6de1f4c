"""What a person's tool needs of a running farm: its status, orders to it, its events from any point on."""

from __future__ import annotations

import itertools
import queue
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec

from saflite.bus.access import Peer
from saflite.bus.base import Bus, Happening, Reply, Sample
from saflite.bus.keyring import Credentials
from saflite.contract import topics, wire
from saflite.contract.bounds import Word
from saflite.contract.clock import Clock
from saflite.contract.control import Answer, Control, Status, Verb
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.contract.events import CampaignChanged, Event
from saflite.contract.names import Name
from saflite.contract.outside import TEXT_BYTES_MAX, read_bytes
from saflite.runtime import farm_register
from saflite.runtime.clock import WallClock
from saflite.runtime.discovery import LOOK_S, only_campaign
from saflite.simulator_worker.processes import identity

FARM_FILE = "farm.json"
ANSWER_S = 5.0
RETRY_S = 0.2
EARLY_MAX = 10_000
"""Facts kept that came before earlier ones: those that are left out are asked for."""
QUIET_S = 1.0  # after this long without a fact the books are asked whether one was missed

T = TypeVar("T")
Pid = Annotated[int, msgspec.Meta(ge=1, le=2**31 - 1)]


class FarmInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Where a farm is reached; `farm.json` in the run folder, whose inode is `folder`: a copy's is another.

    Its launcher is `pid`, and `launcher` the `identity` of it: a number alone is soon another's.
    """

    folder: Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)] = 0
    campaign: Name
    endpoint: Word
    insecure: bool = False
    pid: Pid
    launcher: Word = ""
    processes: Annotated[dict[Name, Pid], msgspec.Meta(max_length=10_000)] = {}


class Copied(Refused):
    """The run folder is a copy, made while a farm worked in the other: that farm is not its own."""


def _inode(run_dir: Path) -> int:
    return run_dir.stat().st_ino & (2**63 - 1)


def write_info(run_dir: Path, info: FarmInfo) -> None:
    """Write `farm.json`, whole or not at all, for this user only."""
    part = run_dir / f"{FARM_FILE}.part"
    part.unlink(missing_ok=True)
    part.touch(mode=0o600)
    here = msgspec.structs.replace(info, folder=_inode(run_dir), launcher=identity(info.pid))
    part.write_bytes(msgspec.json.format(msgspec.json.encode(here)))
    part.replace(run_dir / FARM_FILE)


def read_info(run_dir: Path) -> FarmInfo:
    """Return what `farm.json` says; raises Refused if there is none or it is damaged, Copied if it is another's.

    That all who reach the endpoint may be trusted is believed only of a farm that this user started: a run folder may
    come from anybody, and name any address.
    """
    path = run_dir / FARM_FILE
    try:
        info = wire.unpack_json(read_bytes(path, FARM_FILE, TEXT_BYTES_MAX), FarmInfo)
        if info.folder != _inode(run_dir):
            raise Copied(
                "run folder",
                where=str(run_dir),
                expected="one of a running farm",
                got=f"a copy of one: {FARM_FILE} tells of a farm that works elsewhere",
                fix="name the run folder that it works in",
            )
        return msgspec.structs.replace(info, insecure=info.insecure and farm_register.is_noted(run_dir))
    except Copied:
        raise
    except Refused as fault:
        raise Refused("run folder", where=str(run_dir), expected="one of a running farm", got=fault.got) from fault
    except wire.UNREADABLE as fault:
        raise Refused("run folder", where=str(run_dir), expected="one of a running farm", got=str(fault)) from fault


def holds(control: Control, status: Status) -> bool:
    """Return whether a campaign is as an order wants it."""
    match control.verb:
        case "stop":
            return status.state == "ended"
        case "pause":
            return status.state == "paused"
        case "resume":
            return status.state == "running"
        case "budget":
            return status.budget == control.number
        case "scorer":
            return control.text in (status.scorer, *status.scorer_pending.split(","))
        case _:
            return False


def _nothing() -> None:
    return


def _events_of(answer: Answer) -> list[Event]:
    return [wire.decode(data, Event) for data in answer.events]


def _from(wanted: int, events: list[Event]) -> list[Event]:
    """Return events that are to follow each other from a number on; raises Refused for others: that would never end."""
    if [event.seq for event in events] != list(range(wanted, wanted + len(events))):
        raise Refused("answer of the books", expected=f"events from {wanted} on, in order", got="others")
    return events


class FarmClient:
    """A connection to a running farm. Not for use from several threads."""

    def __init__(
        self,
        bus: Bus,
        campaign: str,
        clock: Clock | None = None,
        *,
        peer: Peer | None = None,
        access: Callable[[], str] = str,
    ) -> None:
        """`peer` is whose key opened the bus; `access` asks the farm what it may do, for when nobody answers."""
        self._bus, self._campaign, self._peer, self._access = bus, campaign, peer, access
        self._clock: Clock = clock or WallClock()
        self._inbox: queue.SimpleQueue[Happening] = queue.SimpleQueue()
        self._facts: queue.SimpleQueue[Happening] = queue.SimpleQueue()
        self._count = itertools.count()

    @classmethod
    def connect(
        cls,
        endpoint: str,
        campaign: str,
        *,
        patience_s: float | None = 6.0,
        insecure: bool = False,
        keys: Credentials | None = None,
    ) -> FarmClient:
        """Return a client of the farm at `endpoint`; `keys` prove who asks, where the endpoint wants that.

        Without a name of a campaign it is the one that runs there.

        Raises:
            Refused: others can reach the endpoint and `insecure` does not allow that, or several campaigns run there.
            Unavailable: nobody is reached there.
        """
        from saflite.bus.zenoh import open_client

        bus = open_client("console", endpoint, patience_s=patience_s, insecure=insecure, keys=keys)
        try:
            campaign = campaign or only_campaign(bus, endpoint, LOOK_S)
            if keys is not None and keys.peer is not None and not keys.peer.may(campaign):
                raise Refused("--campaign", expected=f"one the key is for: {keys.peer.in_words()}", got=repr(campaign))
        except FarmError:
            bus.close()
            raise
        return cls(bus, campaign, peer=keys.peer if keys is not None else None, access=bus.access)

    @classmethod
    def of_run(cls, run_dir: Path, *, insecure: bool = False) -> FarmClient:
        """Return a client of the farm that works in `run_dir`; raises as `read_info` and `connect` do."""
        info = read_info(run_dir)
        return cls.connect(info.endpoint, info.campaign, insecure=insecure or info.insecure)

    @property
    def campaign(self) -> str:
        """The campaign whose farm this is."""
        return self._campaign

    def event(self, seq: int, *, within_s: float = ANSWER_S) -> Event | None:
        """Return an event by its number, None if there is none; the first tells the run from others of its name."""
        return next(iter(_events_of(self.order("events", number=seq, within_s=within_s))), None)

    def order(self, verb: Verb, text: str = "", number: int = 0, *, within_s: float = 30.0) -> Answer:
        """Give an order and return the answer; asks again while nobody answers.

        After silence it asks over a new link: one can look alive and carry nothing (`Bus.renew`). An order whose answer
        was lost was taken all the same: asked again, the books may object that it holds already, which is no refusal.

        Raises:
            Refused: the key is not for that, or the books cannot read it.
            Unavailable: no answer within `within_s`.
        """
        if self._peer is not None and not self._peer.may_order(verb):
            raise Refused("key", expected=f"one that may `{verb}`", got=self._peer.in_words())
        access = ""
        control = Control(verb=verb, text=text, number=number)
        payload, asked_before = wire.encode(control), False
        until_s = self._clock.monotonic_s() + within_s
        while True:
            tag, asked_s = next(self._count), self._clock.monotonic_s()
            self._bus.ask(topics.control(self._campaign, verb), payload, tag, self._inbox.put, ANSWER_S)
            reply = self._reply(tag)
            if reply.payload is not None:
                answer = wire.decode(reply.payload, Answer)
                if asked_before and answer.status is not None and holds(control, answer.status):
                    return msgspec.structs.replace(answer, accepted=True, message="")
                return answer
            asked_before = True
            if reply.refused:
                raise Refused("order", expected="one the books can read", got=reply.refused)
            if self._clock.monotonic_s() >= until_s:
                words = f"the books of {self._campaign} did not answer for {within_s:.0f} s"
                raise Unavailable(f"{words}; {access}" if access else words)
            access = access or self._access()
            if self._clock.monotonic_s() - asked_s >= ANSWER_S - RETRY_S:  # not even that nobody is there was said
                self._bus.renew()
            self._pause(RETRY_S)

    def status(self, *, within_s: float = 30.0) -> Status:
        """Return the campaign at a glance; raises Unavailable if the books do not answer, Refused for other answers."""
        status = self.order("status", within_s=within_s).status
        if status is None:
            raise Refused("answer of the books", expected="a status", got="none")
        return status

    def watch(
        self, from_seq: int = 1, *, patience_s: float = 30.0, on_quiet: Callable[[], None] = _nothing
    ) -> Iterator[Event]:
        """Yield every event from `from_seq` (the first is 1) on, in order, none twice or left out, up to the end.

        That is the end of the campaign as it stands: one that had ended and was taken up again is followed on, one
        that has ended and has nothing more to tell is not waited for. `on_quiet` is called whenever there is nothing
        new yet; what it raises ends the watch.

        Raises:
            Unavailable: the books did not answer for `patience_s`.
            Refused: they answer with other events than they were asked for.
        """
        self._bus.follow(topics.event(self._campaign, "*"), self._facts.put)
        early: dict[int, Event] = {}
        wanted, known_seq, over = from_seq, 0, False  # the books' last event when asked last, and whether all was over
        while True:
            missed: list[Event] = []
            if wanted not in early:
                answer = self.order("events", number=wanted, within_s=patience_s)
                missed = _from(wanted, _events_of(answer))
                early.update((event.seq, event) for event in missed)
                if answer.status is not None:
                    known_seq, over = answer.status.seq, answer.status.state == "ended"
            while wanted in early:
                event = early.pop(wanted)
                wanted += 1
                yield event
                if isinstance(event.fact, CampaignChanged) and event.fact.state == "ended" and event.seq >= known_seq:
                    return
            if over and wanted > known_seq:
                return
            if not missed:  # otherwise there may be more than went into one answer
                on_quiet()
                self._collect(early, wanted)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()

    def _collect(self, early: dict[int, Event], wanted: int) -> None:
        """Take live facts until the wanted one is there, a gap shows, or all is quiet."""
        until_s = self._clock.monotonic_s() + QUIET_S
        while wanted not in early:
            left_s = until_s - self._clock.monotonic_s()
            if left_s <= 0:
                return
            try:
                fact = self._facts.get(timeout=left_s)
            except queue.Empty:
                return
            event = wire.decode(fact.payload, Event) if isinstance(fact, Sample) else None
            if event is not None and event.seq >= wanted and (event.seq == wanted or len(early) < EARLY_MAX):
                early[event.seq] = event
                until_s = min(until_s, self._clock.monotonic_s() + RETRY_S)  # a gap is filled from the books, soon

    def _reply(self, tag: int) -> Reply:
        while True:
            reply = self._inbox.get()
            if isinstance(reply, Reply) and reply.tag == tag:
                return reply

    def _pause(self, duration_s: float) -> None:
        try:
            self._inbox.get(timeout=duration_s)
        except queue.Empty:
            return
