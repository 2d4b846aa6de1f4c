"""Flights with autopilots in processes of their own, for tests: the one that a variable names, or a program of ours."""

from __future__ import annotations

import os
import select
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from msgspec.structs import replace

from saflite.conformance.flying import opened
from saflite.contract.flight import FlightRecord
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
from saflite.flight.autopilots.external.adapter import Adapter
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import Place
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.registry import load_target, why_missing

Given = tuple[float, StimulusKind, str, float]


class StandIn(NamedTuple):
    """A program of ours that speaks an autopilot's protocols, and where it flies."""

    adapter: Adapter
    binary: Binary
    listing: Listing
    place: Place
    settings: Mapping[str, str] = {}

    def flown(
        self, *stimuli: Given, start: StartState | None = None, limit_s: float = 4.0, **parameters: float
    ) -> FlightRecord:
        """Fly a hover with inputs."""
        return self.fly(case(self.name, *stimuli, start=start, limit_s=limit_s, scenario=None, **parameters))

    def fly(self, test_case: TestCase, *, cancelled: bool = False) -> FlightRecord:
        """Fly a test case, with the settings it has here."""
        target = replace(test_case.target, settings=dict(self.settings))
        test_case = replace(test_case, target=target)
        self.adapter.check(test_case, self.listing)
        return self.adapter.flight(test_case, self.binary, self.listing, self.place).run(lambda: cancelled)

    @property
    def name(self) -> str:
        return self.adapter.binaries.target


def program(adapter: Adapter, folder: Path) -> Binary:
    """Write a stand-in where a build would lie; its source is `NAME_peer.py` beside this file."""
    name = adapter.binaries.target
    path = folder / "build" / "bin" / name
    path.parent.mkdir(parents=True)
    (folder / "build" / "etc" / "init.d-posix").mkdir(parents=True)
    path.write_text(f'#!/bin/sh\nexec {sys.executable} {Path(__file__).with_name(f"{name}_peer.py")} "$@"\n')
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return Binary(path, "ab" * 32, "a peer", adapter.binaries.state(path))


def case(
    name: str,
    *stimuli: Given,
    start: StartState | None = None,
    limit_s: float = 4.0,
    scenario: Scenario | None = None,
    **parameters: float,
) -> TestCase:
    """Return a test case from the target's first start state, 5 m up, or another scenario."""
    first = start or StartState(mode=load_target(name).describe().start_states[0].mode, altitude_m=5.0)
    return TestCase(
        target=Target(name=name, parameters=parameters),
        scenario=scenario or Scenario(start=first, time_limit_s=limit_s),
        stimuli=tuple(
            Stimulus(at_s=at, kind=kind, name=word, values=() if kind == "mode" else (value,))
            for at, kind, word, value in stimuli
        ),
        rng_seed=3,
    )


def answers(record: FlightRecord) -> list[str]:
    """Return what became of each input."""
    return [one.answer for one in record.delivered or ()]


@contextmanager
def nothing_left() -> Iterator[None]:
    """Hold what runs inside to leave no process alive; tests of other files may have left their helpers.

    Where another test made this process the heir of orphans, those that have died stay its children until it ends.
    """
    before = set(children(os.getpid()))
    yield
    assert [pid for pid in children(os.getpid()) if pid not in before and not ends(pid)] == []


def ends(pid: int, within_s: float = 20.0) -> bool:
    """Return whether a process is dead within some time, reaped or not."""
    try:
        watched = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([watched], [], [], within_s)[0])
    finally:
        os.close(watched)


def needs_binary(adapter: Adapter) -> None:
    """Skip a test where the environment names no binary; one that is named and does not start fails it."""
    if not os.environ.get(adapter.binaries.variable):
        pytest.skip(f"{adapter.binaries.variable} names no binary")
    assert not why_missing(adapter.binaries.target)


def really_flown(adapter: Adapter, *cases: TestCase) -> list[FlightRecord]:
    """Fly in one session with the binary that the environment names, skip where it names none; no process is left.

    A binary that is named and does not start fails the test.
    """
    needs_binary(adapter)
    name = adapter.binaries.target
    with nothing_left(), opened(load_target(name)) as session:
        return [session.fly(one, 300.0, lambda: False) for one in cases]
