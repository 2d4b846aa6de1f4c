"""Runs a campaign to its end on this machine: opens the books, starts a farm, follows it, stops it clean."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from saflite.contract.config import Campaign
from saflite.contract.control import Control, Status
from saflite.contract.errors import Refused, RefusedElsewhere, Unavailable
from saflite.contract.modules import use
from saflite.contract.work import Stage
from saflite.runtime import run_hosts, run_modules, stop_note
from saflite.runtime.autoscaling import Bounds
from saflite.runtime.client import FarmClient
from saflite.runtime.clock import WallClock
from saflite.runtime.farm import LocalFarm, WorkerRefused, counts_of, default_simulators, roles_of, with_scorers
from saflite.runtime.on_ray import HERE, workers_on

if TYPE_CHECKING:
    from saflite.campaign.storage.store import Store

log = logging.getLogger(__name__)

POLL_S = 0.05
LOCK_WAIT_S = 1.0
STATUS_S = 0.5
STATUS_PATIENCE_S = 2.0
BUILD_SHOWN = 12

OnStatus = Callable[[Status], None]
T = TypeVar("T")


class ExitSummary(NamedTuple):
    """How a local run ended, and why. `ended` False: stopped before its end, `saflite resume` continues it.

    `failed`: a part of it broke before the budget was flown: the strategy, where it ended, or else one of its own
    workers, which is let in no more.
    """

    ended: bool
    why: str
    status: Status | None
    restarts: int
    failed: bool = False


class StopWhen(NamedTuple):
    """When to stop a run before its budget is spent, as for a check of a pull request."""

    after_s: float | None = None
    at_first: bool = False

    def why(self, elapsed_s: float, status: Status | None) -> str:
        """Return why to stop now, empty to go on."""
        if self.at_first and status is not None and status.violations_confirmed:
            return "the first violation is confirmed, as asked for"
        if self.after_s is not None and elapsed_s >= self.after_s:
            return f"{self.after_s / 60.0:g} minutes are over, as asked for"
        return ""


NEVER = StopWhen()


def run_campaign(
    campaign: Campaign,
    run_dir: Path,
    *,
    simulators: int | None = None,
    on_status: OnStatus | None = None,
    modules: Sequence[Path] = (),
) -> ExitSummary:
    """Run a new campaign to its end on this machine.

    Raises:
        Refused: `run_dir` exists, or the campaign cannot be run.
        Unavailable: the farm cannot start.
    """
    from saflite.campaign.presets.campaigns import template
    from saflite.campaign.storage.store import Store
    from saflite.simulator_worker.registry import describe_target

    used = use(modules)
    target = describe_target(campaign.target.name)
    Store.create(run_dir, campaign, template(campaign, target.build), target).close()
    run_modules.note(run_dir, used)
    run_hosts.note(run_dir, campaign.scorer)
    return resume(run_dir, simulators=simulators, on_status=on_status)


def resume(
    run_dir: Path,
    *,
    simulators: int | None = None,
    cast: Mapping[Stage, int] | None = None,
    on_status: OnStatus | None = None,
    modules: Sequence[Path] = (),
    budget: int | None = None,
    listen: str = "",
    keys: Path | None = None,
    insecure: bool = False,
    json_logs: bool = False,
    on: str = HERE,
    scale: Mapping[Stage, Bounds] = MappingProxyType({}),
    stop_when: StopWhen = NEVER,
) -> ExitSummary:
    """Continue the campaign in `run_dir` to its end on this machine, with a new budget if one is given.

    `modules` are files from outside, besides those the run was made with, or in place of them where they have the same
    name. `cast`, if given, says how many workers of each stage run here. `simulators` 0 leaves the flying to workers
    that join at `listen` (see `LocalFarm`). `on` says where the workers run: here, or `ray` (see `runtime/on_ray.py`).
    `scale` bounds the workers of stages whose number follows their queues; scorers follow simulators unless named.
    `stop_when` ends it earlier; it can be resumed.

    Raises:
        Refused: no run folder, one in use, a damaged store, a run of another build of its target than the one here,
            or an endpoint that needs `insecure`.
        Unavailable: the farm cannot start.
    """
    used = run_modules.use(run_dir, modules)
    flies = cast.get("fly", 0) if cast is not None else simulators
    check_build(run_dir, flies_here=flies != 0 and on == HERE, goes_on=budget is not None)
    campaign = _campaign(run_dir, budget)
    run_modules.note(run_dir, used)
    record, hosts, paths = campaign.record != "none", run_hosts.of(run_dir, campaign.scorer), [one.path for one in used]
    workers = None if on == HERE else workers_on(on, campaign.name, modules=paths, keys=keys, key_hosts=hosts)
    count = (workers.cores if workers else default_simulators()) if simulators is None else simulators
    prefix = workers.prefix if workers else ""
    scale = with_scorers(scale) if cast is None else scale
    counts = dict(cast) if cast is not None else counts_of(count, record=record)
    farm = LocalFarm(
        campaign.name,
        run_dir,
        roles_of({**counts, **{stage: bounds.min for stage, bounds in scale.items()}}, prefix=prefix),
        modules=paths,
        listen=listen,
        keys=keys,
        insecure=insecure,
        json_logs=json_logs,
        elsewhere=workers.launcher if workers else None,
        scale=scale,
        prefix=prefix,
        key_hosts=hosts,
    )
    return _work(farm, on_status, stop_when)


def _work(farm: LocalFarm, on_status: OnStatus | None, stop_when: StopWhen) -> ExitSummary:
    """Let a farm work to the end of its campaign, or until it is stopped: that is noted in the run folder."""
    stop_note.forget(farm.run_dir)
    with interrupts() as interrupted:
        try:
            farm.start()
            ended = _follow(farm, on_status, interrupted, stop_when)
        except Unavailable as fault:
            stop_note.note(farm.run_dir, str(fault), failed=True)
            raise
        finally:
            farm.stop()
    if not ended.ended:
        stop_note.note(farm.run_dir, ended.why, failed=ended.failed)
        return ended
    return _as_the_books_tell(farm.run_dir, ended)


def _as_the_books_tell(run_dir: Path, ended: ExitSummary) -> ExitSummary:
    """Return how a run ended with the reason that stands in its books."""
    from saflite.campaign.storage.audit import last_change

    last = last_change(run_dir)
    return ended if last is None or last.state != "ended" else ended._replace(why=last.why, failed=last.failed)


def check_build(run_dir: Path, *, flies_here: bool, goes_on: bool) -> None:
    """Refuse a run whose flights nobody here could fly: its target's build is another now, and it would wait for ever.

    Not a run that is over, unless it `goes_on` with a new budget; nor one whose target cannot be described here: its
    simulators may join from elsewhere.

    Raises:
        Refused: it is one, or no run that can be taken up again.
        Unavailable: it is one, since what its target needs is missing here.
    """
    from saflite.campaign.storage.store import target_of
    from saflite.simulator_worker.registry import describe_target

    wanted = _when_free(lambda: target_of(run_dir))
    if not (flies_here and wanted.build):
        return
    try:
        here = describe_target(wanted.name)
    except (Refused, Unavailable):
        return
    if here.build != wanted.build and (goes_on or not _is_over(run_dir)):
        if here.missing:
            raise Unavailable(here.missing)
        raise Refused(
            f"build of {wanted.name}",
            where=str(run_dir),
            expected=f"{wanted.build[:BUILD_SHOWN]}, which this run flies",
            got=here.build[:BUILD_SHOWN],
            fix="take it up with the software it was made with, or with --workers 0 --listen, for workers that have it",
        )


def _is_over(run_dir: Path) -> bool:
    store = _open(run_dir)
    try:
        return bool(store.rebuild().audit_status()["over"])
    finally:
        store.close()


def _campaign(run_dir: Path, budget: int | None) -> Campaign:
    """Return the campaign of a run that can be taken up again; the order for a new budget is given."""
    from saflite.campaign.storage.store import campaign_of

    if budget is None:
        return _when_free(lambda: campaign_of(run_dir))
    store = _open(run_dir)
    try:
        _raise_budget(store, budget)
    finally:
        store.close()
    return store.campaign


def _open(run_dir: Path) -> Store:
    from saflite.campaign.storage.store import Store

    return _when_free(lambda: Store.open(run_dir))


def _when_free(do: Callable[[], T]) -> T:
    """Do something to a run; waits a moment for one just killed, whose lock goes only with its last file."""
    from saflite.campaign.storage.sqlite import InUse

    clock = WallClock()
    until_s = clock.monotonic_s() + LOCK_WAIT_S
    while True:
        try:
            return do()
        except InUse:
            if clock.monotonic_s() > until_s:
                raise
            clock.sleep_s(POLL_S)


def _raise_budget(store: Store, budget: int) -> None:
    """Give the order before anybody works: an ended campaign would send its workers home first."""
    clock = WallClock()
    books = store.rebuild()
    books.begin(clock.monotonic_s(), clock.unix_s())
    answer = books.control(Control(verb="budget", number=budget), clock.monotonic_s())
    if not answer.accepted:
        raise RefusedElsewhere("budget", answer.message)
    store.commit(books.drain())


def accept_loss(run_dir: Path, words: str) -> None:
    """Take what is left of a run for all there is; `words`, what is lost, are noted in its books.

    Raises:
        Refused: the run is in use, or its journal is damaged.
        Unavailable: the disk fails.
    """
    from saflite.campaign.storage.witness import accept_loss as begin_anew

    begin_anew(run_dir)
    clock = WallClock()
    store = _open(run_dir)
    try:
        books = store.rebuild()
        books.begin(clock.monotonic_s(), clock.unix_s())
        books.fault("books", f"loss accepted: {words}"[:500], clock.monotonic_s())
        store.commit(books.drain())
    finally:
        store.close()


class Follower:
    """Asks the books of a farm how the campaign stands. `connect` opens a connection, once it is needed."""

    def __init__(self, connect: Callable[[], FarmClient]) -> None:
        self._connect, self._told = connect, ""
        self._client: FarmClient | None = None

    def status(self) -> Status | None:
        """Return the status; None, and told why, where nobody answers or it cannot be read: the farm works on."""
        try:
            client = self._client = self._client or self._connect()
        except Unavailable as fault:
            log.info("%s", fault)
            return None
        try:
            status = client.status(within_s=STATUS_PATIENCE_S)
        except Unavailable as fault:
            log.info("%s", fault)
        except Refused as fault:
            if self._told != str(fault):
                log.warning("the status cannot be read, and is asked for again: %s", fault)
            self._told = str(fault)
        else:
            self._told = ""
            return status
        return None

    def close(self) -> None:
        """Leave the bus."""
        if self._client is not None:
            self._client.close()


def _follow(farm: LocalFarm, on_status: OnStatus | None, interrupted: list[str], stop_when: StopWhen) -> ExitSummary:
    clock = WallClock()
    began_s = clock.monotonic_s()
    status: Status | None = None
    next_s = clock.monotonic_s()
    follower = Follower(
        lambda: FarmClient.connect(farm.endpoint, farm.campaign, patience_s=2.0, insecure=farm.insecure)
    )
    try:
        while not interrupted and not farm.over():
            try:
                farm.poll()
            except WorkerRefused as fault:
                return ExitSummary(False, str(fault), status, farm.restarts, failed=True)
            clock.sleep_s(POLL_S)
            if why := stop_when.why(clock.monotonic_s() - began_s, status):
                return ExitSummary(False, why, status, farm.restarts)
            if clock.monotonic_s() < next_s:
                continue
            if (heard := follower.status()) is not None:
                status = heard
                farm.rescale(status, clock.monotonic_s())
                if on_status is not None:
                    on_status(status)
                if status.state == "ended":
                    return ExitSummary(True, "the campaign is over", status, farm.restarts)
            next_s = clock.monotonic_s() + STATUS_S
    finally:
        follower.close()
    why = interrupted[0] if interrupted else "the campaign is over"
    if interrupted:  # its processes may take a while to end
        log.warning("%s: stopping; what is under way is handed back", why)
    return ExitSummary(farm.over(), why, status, farm.restarts)


@contextmanager
def interrupts() -> Iterator[list[str]]:
    """Turn Ctrl-C, SIGTERM and a closed terminal into a note instead of an end, while the farm runs.

    Only the main thread of a program hears of signals: from another, as in a notebook, they do what they did before.
    """
    noted: list[str] = []
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return

    def note(number: int, _frame: FrameType | None) -> None:
        noted.append(f"{stop_note.SIGNAL}{signal.Signals(number).name}")
        if number == signal.SIGHUP:
            _write_nowhere()

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _write_nowhere() -> None:
    """Lead standard output and errors away from a terminal that is gone: what is written there would fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
