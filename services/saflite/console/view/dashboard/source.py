"""What the dashboard shows of one campaign: a run folder, with the farm that works in it, or a farm at an endpoint."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Protocol, cast

import msgspec

from saflite.console.run_data import farm_lookup
from saflite.console.run_data.embargo import ToldFaults, withheld_words
from saflite.console.run_data.farm_lookup import Where
from saflite.console.run_data.in_force import budgets, in_force
from saflite.console.run_data.run_folder import RunFolder, open_run
from saflite.console.view.dashboard import finds
from saflite.console.view.report import data, page
from saflite.contract import wire
from saflite.contract.control import NOT_RUNNING, Answer, Status, Verb
from saflite.contract.errors import FarmError, Refused
from saflite.contract.events import CampaignChanged, Event, ViolationFound
from saflite.contract.names import is_name
from saflite.contract.verdict import Violation, with_mode_named
from saflite.runtime.client import FarmClient
from saflite.runtime.clock import WallClock

FRESH_S = 0.8
"""A status younger than this is shown again instead of asking the books."""
PATIENCE_S = 2.0
ANSWERS_MAX = 50
"""Answers with new events that one look at a farm elsewhere takes: the rest comes with the next, and none may end."""
FOUND_MAX = 20_000
"""Finds of a farm elsewhere that are kept, the first ones: more than anybody reads."""
REST = 20.0
"""Times the time it took to make, a part of a run that goes on is shown before it is made again."""


class Head(NamedTuple):
    """What a run is: told once. `where` tells it from others of its campaign: its folder's name, or an endpoint."""

    name: str
    description: str
    target: str
    build: str
    began_unix_s: float
    where: str = ""


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """What changes while it runs. `status` None: no farm works on it. `version` changes with what the parts show."""

    state: str
    flights: int = 0
    budget: int = 0
    reflown: int = 0
    behaviours: int = 0
    finds: int = 0
    flaky: int = 0
    elapsed_s: float = 0.0
    version: int = 0
    status: Status | None = None


class Source(Protocol):
    """One campaign. Methods may be called from several threads."""

    def head(self) -> Head:
        """Return what it is."""
        ...

    def settings(self) -> str:
        """Return what was chosen for it, and what an operator has changed since, as HTML."""
        ...

    def figures(self) -> Figures:
        """Return how it stands now."""
        ...

    def violations(self, *, public: bool) -> list[Violation]:
        """Return the finds, without similar ones, in the order found; `public`: without those of memory safety."""
        ...

    def part(self, name: str) -> str:
        """Return a part of the page as HTML; raises Refused for an unknown one."""
        ...

    def find(self, test_case: str, *, public: bool) -> str:
        """Return all that is known of one find, as HTML; raises Refused for one that `violations` does not show."""
        ...

    def file(self, name: str, *, public: bool) -> Path | None:
        """Return a recording, None if there is none of that name to be shown."""
        ...

    def order(self, verb: Verb, text: str, number: int) -> Answer:
        """Give the farm an order; raises Refused or Unavailable."""
        ...


class _Farm:
    """A client of the farm, opened when needed, one question at a time."""

    def __init__(self, connect: Callable[[], FarmClient]) -> None:
        self._connect, self._client = connect, cast(FarmClient | None, None)
        self._lock, self._clock = threading.Lock(), WallClock()
        self._status: Status | None = None
        self._asked_s = -1e9

    def status(self) -> Status | None:
        """Return the campaign at a glance, None if nobody answers."""
        with self._lock:
            if self._clock.monotonic_s() - self._asked_s < FRESH_S:
                return self._status
            try:
                self._status = self._opened().status(within_s=PATIENCE_S)
            except FarmError:
                self._drop()
                self._status = None
            self._asked_s = self._clock.monotonic_s()
            return self._status

    def order(self, verb: Verb, text: str = "", number: int = 0) -> Answer:
        """Give an order; raises Refused or Unavailable."""
        with self._lock:
            self._asked_s = -1e9
            return self._opened().order(verb, text, number, within_s=10.0)

    def _opened(self) -> FarmClient:
        if self._client is None:
            self._client = self._connect()
        return self._client

    def _drop(self) -> None:
        if self._client is not None:
            with suppress(Exception):
                self._client.close()
            self._client = None


class _Part(NamedTuple):
    """A part of the page as it was made: of the events up to `version`, when, in what time."""

    version: int
    html: str
    made_s: float
    took_s: float


class RunSource:
    """A run folder."""

    def __init__(self, run_dir: Path) -> None:
        self._dir = run_dir
        self._farm = _Farm(lambda: FarmClient.of_run(run_dir))
        self._kept: dict[str, _Part] = {}
        self._making, self._clock = {name: threading.Lock() for name in _PARTS}, WallClock()
        folder = run_dir.resolve().name
        try:
            with open_run(run_dir) as run:
                self._head = _head(run, folder)
        except FarmError:  # said wherever it is asked for more
            self._head = Head(folder, "", "", "", 0.0, folder)

    def head(self) -> Head:
        """Return what it is."""
        return self._head

    def settings(self) -> str:
        """Return what was chosen, and changed."""
        with open_run(self._dir) as run:
            return page.settings(run.campaign, in_force(run))

    def figures(self) -> Figures:
        """Return how it stands: from the farm, or from the books of one that does not run."""
        status = self._farm.status() if farm_lookup.says_it_runs(self._dir) else None
        if status is not None:
            return _of_status(status)
        with open_run(self._dir) as run:
            flown, standings = run.flown(), run.standings()
            last, changes = run.last_events(1), run.facts(CampaignChanged)
            return Figures(
                state="ended" if changes and changes[-1].state == "ended" else NOT_RUNNING,
                flights=flown["search"],
                budget=(run.campaign.budget_flights, *budgets(run))[-1],
                reflown=flown["confirm"],
                behaviours=len({one.fingerprint for one in run.violations("confirmed")}),
                finds=standings["confirmed"] + standings["similar"],
                flaky=standings["flaky"],
                elapsed_s=run.elapsed_s(),
                version=last[-1].seq if last else 0,
            )

    def violations(self, *, public: bool) -> list[Violation]:
        """Return the finds."""
        with open_run(self._dir) as run:
            hidden = run.memory_faults() if public else frozenset()
            found = (one for one in run.violations(similar=False) if one.test_case not in hidden)
            return [with_mode_named(one, run.target.modes) for one in found]

    def part(self, name: str) -> str:
        """Return a part of the page; what has not changed is not made again.

        Nor is what was made a moment ago while flights go on: a part of a long run takes seconds of a core that flies.
        """
        maker = _PARTS.get(name)
        if maker is None:
            raise Refused("part", expected=f"one of {', '.join(_PARTS)}", got=repr(name))
        with self._making[name], open_run(self._dir) as run:
            last = run.last_events(1)
            version, kept, now_s = last[-1].seq if last else 0, self._kept.get(name), self._clock.monotonic_s()
            if kept is not None and (kept.version == version or self._is_fresh(kept, now_s)):
                return kept.html
            html = maker(run)
            self._kept[name] = _Part(version, html, now_s, self._clock.monotonic_s() - now_s)
            return html

    def _is_fresh(self, kept: _Part, now_s: float) -> bool:
        return now_s < kept.made_s + REST * kept.took_s and farm_lookup.says_it_runs(self._dir)

    def find(self, test_case: str, *, public: bool) -> str:
        """Return one find with its pictures, beside the last good flight."""
        with open_run(self._dir) as run:
            if public and test_case in run.memory_faults():
                raise Refused("test case", expected="one that may be shown", got=withheld_words(1))
            return finds.shown(run, test_case, str(self._dir))

    def file(self, name: str, *, public: bool) -> Path | None:
        """Return a recording."""
        path = self._dir / "recordings" / name
        if not is_name(name):  # it leads elsewhere, or no file system holds it: a fault, not a file that is not there
            return None
        if public:
            with open_run(self._dir) as run:
                if name.partition("-")[0] in run.memory_faults():
                    return None
        is_ours = path.suffix == ".mcap" and not (path.is_symlink() or path.parent.is_symlink())
        return path if is_ours and path.is_file() else None

    def order(self, verb: Verb, text: str, number: int) -> Answer:
        """Give the farm an order."""
        return self._farm.order(verb, text, number)


def _head(run: RunFolder, folder: str) -> Head:
    first = run.first_event()
    return Head(
        run.campaign.name,
        run.campaign.description,
        run.campaign.target.name,
        run.target.build,
        first.at_unix_s if first else 0.0,
        folder,
    )


def _of_status(status: Status) -> Figures:
    return Figures(
        state=status.state,
        flights=status.flights,
        budget=status.budget,
        reflown=status.reflown,
        behaviours=status.behaviours,
        finds=status.violations_confirmed + status.violations_similar,
        flaky=status.violations_flaky,
        elapsed_s=status.elapsed_s,
        version=status.seq,
        status=status,
    )


def _troubles(run: RunFolder) -> str:
    quarantined, faults = data.troubles(run)
    return page.troubles(quarantined, faults) or '<p class="muted">No fault so far.</p>'


def _coverage(run: RunFolder) -> str:
    rulings, states = run.coverage()
    seen = data.states_named(run.target, states)
    told = page.policies(rulings) + page.states(seen, data.modes_unseen(run.target, seen))
    return told or '<p class="muted">No flight was judged.</p>'


def _scorers(run: RunFolder) -> str:
    told = page.calibration(data.calibrations(run)) + page.usage(run.usage())
    return told or '<p class="muted">No score was given.</p>'


_PARTS: dict[str, Callable[[RunFolder], str]] = {
    "search": lambda run: page.progress_charts(data.progress(run)),
    "coverage": _coverage,
    "scorers": _scorers,
    "faults": _troubles,
}


class EndpointSource:
    """A farm elsewhere: its figures, workers and finds in words; pictures need the run folder."""

    def __init__(self, where: Where) -> None:
        self._where, self._farm = where, _Farm(lambda: farm_lookup.connect(where))
        self._found = dict[tuple[str, str], Violation]()
        self._faults = ToldFaults()
        self._lock = threading.Lock()

    def head(self) -> Head:
        """Return what is known of it."""
        return Head(self._where.campaign, f"the farm at {self._where.endpoint}", "", "", 0.0, self._where.endpoint)

    def settings(self) -> str:
        """Return nothing: the campaign is elsewhere."""
        return ""

    def figures(self) -> Figures:
        """Return how it stands; `unreachable` where nobody answers."""
        status = self._farm.status()
        if status is not None:
            return _of_status(status)
        return Figures(state="unreachable")

    def violations(self, *, public: bool) -> list[Violation]:
        """Return the finds announced so far."""
        with self._lock:
            with suppress(FarmError):
                self._listen()
            return [one for one in self._found.values() if not (public and one.test_case in self._faults)]

    def _listen(self) -> None:
        """Take the events that are new; raises Refused or Unavailable."""
        next_seq = 0
        for _ in range(ANSWERS_MAX):
            if next_seq == self._faults.next_seq:  # the last answer told nothing new
                return
            next_seq = self._faults.next_seq
            for event in (wire.decode(one, Event) for one in self._farm.order("events", "", next_seq).events):
                self._faults.take(event)
                if isinstance(event.fact, ViolationFound) and event.fact.violation.confirmation != "similar":
                    one = event.fact.violation
                    if len(self._found) < FOUND_MAX or (one.test_case, one.policy) in self._found:
                        self._found[one.test_case, one.policy] = one

    def part(self, name: str) -> str:
        """Return nothing: the books are elsewhere."""
        return '<p class="muted">Shown where the run folder is.</p>'

    def find(self, test_case: str, *, public: bool) -> str:
        """Return the finds of one test case in words."""
        found = [one for one in self.violations(public=public) if one.test_case == test_case]
        if not found:
            raise Refused("test case", expected="one of a find", got=repr(test_case))
        return "".join(map(finds.in_words, found))

    def file(self, name: str, *, public: bool) -> Path | None:
        """Return nothing: recordings are elsewhere."""
        return None

    def order(self, verb: Verb, text: str, number: int) -> Answer:
        """Give the farm an order, as far as the key allows."""
        return self._farm.order(verb, text, number)
