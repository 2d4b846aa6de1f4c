"""The sandbox over a target that crashes, hangs and leaves processes behind: every flight ends, nothing is orphaned."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import unpack_trace
from saflite.contract.test_case import Scenario, Target, TestCase, identity
from saflite.contract.work import FlyResult, FlyWork
from saflite.evidence.memory import MemoryBlobs
from saflite.runtime.clock import WallClock
from saflite.simulator_worker import registry, sandbox
from saflite.simulator_worker.processes import children, kill_strays, starved_s
from saflite.simulator_worker.work import Flyer, open_service

TARGET = Path(__file__).parents[3] / "scripts" / "soaking" / "soak.py"
BLOBS = MemoryBlobs()
CRASH, HANG, NO_BRING_UP, REFUSE, BROKEN, STRAY, SLOW, QUIET = range(1, 9)


@pytest.fixture(scope="module")
def flyer() -> Iterator[Flyer]:
    before = children(os.getpid())
    flyer = open_service("fly-1", WallClock(), BLOBS, [TARGET])
    yield flyer
    flyer.close()
    assert children(os.getpid()) == before


def _fly(
    flyer: Flyer, fault: int, wall_limit_s: float = 20.0, cancelled_after: int = 10**9, target: str = "soak"
) -> FlyResult:
    test_case = TestCase(target=Target(name=target, parameters={"SOAK_FAULT": fault}), scenario=Scenario())
    work = FlyWork(test_case=test_case, flight_index=2, purpose="search", wall_limit_s=wall_limit_s)
    polls = iter(range(10**9))
    result = flyer.do(work, lambda: next(polls) >= cancelled_after)
    assert isinstance(result, FlyResult)
    assert result.flight.test_case == identity(test_case)
    return result


def test_a_flight_comes_back_with_its_trace(flyer: Flyer) -> None:
    result = _fly(flyer, QUIET)
    assert (result.flight.ending, result.flight.flight_index, result.flight.worker) == ("completed", 2, "fly-1")
    assert result.flight.trace is not None
    assert unpack_trace(BLOBS.get(result.flight.trace)).samples == 10
    assert result.flight.simulated_s == pytest.approx(0.9)
    assert _fly(flyer, QUIET).flight.trace_digest == result.flight.trace_digest


def test_the_same_process_flies_again(flyer: Flyer) -> None:
    _fly(flyer, QUIET)
    before = children(os.getpid())
    _fly(flyer, QUIET)
    assert children(os.getpid()) == before


def test_a_crashed_simulator_is_lost_not_a_finding(flyer: Flyer) -> None:
    result = _fly(flyer, CRASH)
    assert result.flight.ending == "lost"
    assert "SIGSEGV" in result.flight.message
    assert _fly(flyer, QUIET).flight.ending == "completed"


def test_a_hang_that_ignores_sigterm_is_killed_with_its_grandchildren(flyer: Flyer) -> None:
    before = set(children(os.getpid()))
    result = _fly(flyer, HANG, wall_limit_s=0.5)
    assert result.flight.ending == "wedged"
    assert 0.5 <= result.flight.wall_s < 3.5
    assert set(children(os.getpid())) <= before
    assert _fly(flyer, QUIET).flight.ending == "completed"


@pytest.mark.parametrize("where", ["describe", "open", "fly", "close"])
def test_compiled_code_that_never_returns_costs_one_simulator(where: str, tmp_path: Path) -> None:
    """It keeps the interpreter of its process to itself: no deadline, signal or order is heard there."""
    before, target = children(os.getpid()), tmp_path / "native.py"
    text = TARGET.read_text().replace('"soak"', '"native"')
    head = next(line for line in text.splitlines() if line.strip().startswith(f"def {where}("))
    indent = " " * (len(head) - len(head.lstrip()) + 4)
    target.write_text(text.replace(head, f"{head}\n{indent}__import__('ctypes').PyDLL(None).pause()"))
    flyer = open_service("fly-4", WallClock(), BLOBS, [target])
    try:
        if where in ("describe", "open"):
            with pytest.raises(Unavailable, match="cancelled"):
                _fly(flyer, QUIET, cancelled_after=1, target="native")
        else:
            result = _fly(flyer, QUIET, wall_limit_s=0.5, target="native")
            assert result.flight.ending == ("wedged" if where == "fly" else "completed")
    finally:
        flyer.close()
    assert children(os.getpid()) == before


def test_bring_up_failure_is_infra(flyer: Flyer) -> None:
    assert _fly(flyer, NO_BRING_UP).flight.ending == "infra"


def test_what_a_flight_leaves_behind_is_killed(flyer: Flyer) -> None:
    _fly(flyer, QUIET)
    before = children(os.getpid())
    assert _fly(flyer, STRAY).flight.ending == "completed"
    assert children(os.getpid()) == before


def test_what_had_ended_by_itself_is_reaped_and_not_called_left_behind() -> None:
    with subprocess.Popen(["sleep", "60"]) as alive, subprocess.Popen(["true"]) as dead:
        os.waitid(os.P_PID, dead.pid, os.WEXITED | os.WNOWAIT)
        known = set(children(os.getpid())) - {alive.pid, dead.pid}
        assert kill_strays(known) == [alive.pid]
        assert set(children(os.getpid())) == known


def test_broken_target_code_ends_the_simulator_not_the_worker(flyer: Flyer) -> None:
    assert _fly(flyer, BROKEN).flight.ending == "lost"


def test_refused_input_is_said(flyer: Flyer) -> None:
    with pytest.raises(Refused, match="another"):
        _fly(flyer, REFUSE)


def test_a_cancelled_flight_ends_and_the_process_lives_on(flyer: Flyer) -> None:
    _fly(flyer, QUIET)
    before = children(os.getpid())
    with pytest.raises(Unavailable, match="cancelled"):
        _fly(flyer, SLOW, cancelled_after=2)
    assert children(os.getpid()) == before
    assert _fly(flyer, QUIET).flight.ending == "completed"


@pytest.mark.parametrize("where", ["describe", "open"])
def test_a_bring_up_is_cancelled_like_a_flight(where: str, tmp_path: Path) -> None:
    """It outlasts the time a worker has to end: its lease was counted as lost."""
    before, target = children(os.getpid()), tmp_path / "stuck.py"
    text = TARGET.read_text().replace('"soak"', '"stuck"')
    head = next(line for line in text.splitlines() if line.startswith(f"def {where}("))
    target.write_text(text.replace(head, f"{head}\n    __import__('threading').Event().wait()"))
    flyer = open_service("fly-3", WallClock(), BLOBS, [target])
    try:
        with pytest.raises(Unavailable, match="cancelled"):
            _fly(flyer, QUIET, cancelled_after=1, target="stuck")
    finally:
        flyer.close()
    assert children(os.getpid()) == before


def test_waiting_for_a_core_is_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many that came up at once on few cores were each killed after 30 s, for ever."""
    flyer = open_service("fly-2", WallClock(), BLOBS, [TARGET])
    monkeypatch.setattr(sandbox, "BRING_UP_S", 0.02)
    result = _fly(flyer, QUIET)
    assert result.flight.ending == "infra"
    assert "said nothing" in result.flight.message
    began_s = time.monotonic()
    monkeypatch.setattr(sandbox, "STARVED_LIMIT", 10_000.0)
    monkeypatch.setattr(sandbox, "starved_s", lambda pid: time.monotonic() - began_s)
    assert _fly(flyer, QUIET).flight.ending == "completed"
    flyer.close()


def test_what_waits_for_a_core_is_seen() -> None:
    core = min(os.sched_getaffinity(0))
    spin = [sys.executable, "-c", f"import os; os.sched_setaffinity(0, {{{core}}})\nwhile True: pass"]
    with subprocess.Popen(spin) as one, subprocess.Popen(spin) as other:
        until_s = time.monotonic() + 60.0
        while min(starved_s(one.pid), starved_s(other.pid)) < 0.2 and time.monotonic() < until_s:
            one.poll()
        waited = starved_s(one.pid), starved_s(other.pid), starved_s(os.getpid())
        one.kill()
        other.kill()
    assert min(waited[:2]) >= 0.2
    assert waited[2] >= max(waited[:2])
    assert starved_s(one.pid) == 0.0


def test_targets_are_found_by_place_and_by_file() -> None:
    assert "soak" in registry.target_names([TARGET])
    assert "soak" not in registry.target_names()
    assert registry.builds_here([TARGET]).keys() >= {"soak", "reference"}
    with pytest.raises(Refused, match="target"):
        registry.load_target("no-such-target")


@pytest.mark.parametrize("name", ["ardupilot", "px4"])
def test_builds_that_listen_for_orders_fly_in_a_network_of_their_own(name: str) -> None:
    """What that keeps away: `tests/live/test_own_network.py`."""
    assert getattr(registry.load_target(name), "own_network", False)
