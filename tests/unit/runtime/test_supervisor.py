"""The supervisor over a launcher that runs nothing and does what it is told: back-off, giving up, order of the end."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from saflite.campaign.scheduling.leases import SILENT_S
from saflite.contract.errors import Unavailable
from saflite.runtime.farm import BREAKS_MAX, REFUSALS_MAX, _gives_up
from saflite.runtime.launchers.base import Condition, RoleSpec, RoleState
from saflite.runtime.supervisor import BACK_OFF_MAX_S, STEADY_S, GaveUp, Supervisor

CAST = (
    RoleSpec(kind="router", name="router", listens=True),
    RoleSpec(kind="books", name="books"),
    RoleSpec(kind="fly", name="fly-1"),
)


class Clock:
    now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return self.now_s

    def sleep_s(self, duration_s: float) -> None:
        self.now_s += duration_s


class Scripted:
    """A launcher whose roles end when the test says so."""

    def __init__(self) -> None:
        self.states: dict[str, RoleState] = {}
        self.started: list[str] = []
        self.stopped: list[str] = []
        self.draining: list[str] = []
        self.full = False

    def start(self, spec: RoleSpec) -> None:
        if self.full:
            raise Unavailable("no room")
        self.started.append(spec.name)
        self.states[spec.name] = RoleState("running")

    def poll(self) -> dict[str, RoleState]:
        return dict(self.states)

    def drain(self, names: Collection[str]) -> None:
        self.draining += names

    def stop(self, names: Collection[str] | None = None) -> None:
        for name in sorted(self.states if names is None else names):
            if self.states.pop(name, None) is not None:
                self.stopped.append(name)

    def end(self, name: str, condition: Condition) -> None:
        self.states[name] = RoleState(condition, "why")


def _stand() -> tuple[Supervisor, Scripted, Clock]:
    launcher, clock = Scripted(), Clock()
    supervisor = Supervisor(launcher, CAST, clock, lambda spec, state, failures: failures.its_own >= 5)
    supervisor.start()
    return supervisor, launcher, clock


def test_what_died_is_started_again_after_its_back_off_and_not_before() -> None:
    supervisor, launcher, clock = _stand()
    launcher.end("fly-1", "broken")
    assert supervisor.poll()
    assert launcher.started.count("fly-1") == 1
    clock.now_s = 0.5
    assert supervisor.poll()
    assert launcher.started.count("fly-1") == 2
    assert supervisor.restarts == 1


def test_the_back_off_grows_and_begins_anew_after_a_steady_life_or_a_kill() -> None:
    supervisor, launcher, clock = _stand()
    waits = []
    for condition, lived_s in [("broken", 0.0)] * 4 + [("killed", 0.0), ("broken", STEADY_S + 1.0)]:
        clock.now_s += lived_s
        launcher.end("fly-1", condition)  # type: ignore[arg-type]
        supervisor.poll()
        died_s, before = clock.now_s, launcher.started.count("fly-1")
        while launcher.started.count("fly-1") == before:
            clock.now_s += 0.1
            supervisor.poll()
        waits.append(round(clock.now_s - died_s, 1))
    assert waits[:4] == sorted(waits[:4])
    assert waits[0] < waits[3] <= BACK_OFF_MAX_S + 0.1
    assert max(waits[4:]) < waits[0]


def test_who_ends_by_itself_has_finished_and_stays_so() -> None:
    supervisor, launcher, clock = _stand()
    launcher.end("books", "finished")
    supervisor.poll()
    clock.now_s = 100.0
    supervisor.poll()
    assert supervisor.finished("books")
    assert not supervisor.over
    assert launcher.started.count("books") == 1


def test_a_role_that_fails_too_often_is_given_up_with_its_last_words() -> None:
    supervisor, launcher, clock = _stand()
    for _ in range(4):
        launcher.end("books", "refused")
        supervisor.poll()
        clock.now_s += BACK_OFF_MAX_S + 0.1
        supervisor.poll()
    launcher.end("books", "refused")
    with pytest.raises(GaveUp, match="books: why"):
        supervisor.poll()


def test_a_launcher_without_room_is_tried_again() -> None:
    supervisor, launcher, clock = _stand()
    launcher.end("fly-1", "killed")
    launcher.full = True
    supervisor.poll()
    clock.now_s = 1.0
    supervisor.poll()
    launcher.full = False
    clock.now_s = 2.0
    supervisor.poll()
    assert launcher.started.count("fly-1") == 2


def test_workers_end_before_the_books_and_the_router_last() -> None:
    supervisor, launcher, _ = _stand()
    supervisor.stop()
    assert launcher.stopped == ["fly-1", "books", "router"]
    assert supervisor.over


def test_who_is_drained_is_not_started_again_whatever_becomes_of_it_and_its_name_is_free_once_it_has_gone() -> None:
    conditions: tuple[Condition, ...] = ("finished", "killed", "broken")
    for condition in conditions:
        supervisor, launcher, clock = _stand()
        supervisor.add(RoleSpec(kind="fly", name="fly-2"))
        assert supervisor.working("fly") == ["fly-1", "fly-2"]
        supervisor.drain(["fly-2"])
        assert launcher.draining == ["fly-2"]
        assert supervisor.working("fly") == ["fly-1"]
        supervisor.poll()
        assert supervisor.knows("fly-2"), "it still works on what it holds"
        launcher.end("fly-2", condition)
        assert supervisor.poll()
        clock.now_s = 100.0
        supervisor.poll()
        assert not supervisor.knows("fly-2")
        assert launcher.started.count("fly-2") == 1
        assert "fly-2" not in launcher.poll()


def test_who_waits_to_be_started_again_is_drained_at_once() -> None:
    supervisor, launcher, clock = _stand()
    launcher.end("fly-1", "killed")
    supervisor.poll()
    supervisor.drain(["fly-1"])
    clock.now_s = 100.0
    supervisor.poll()
    assert launcher.started.count("fly-1") == 1
    assert supervisor.counts() == {"running": 2, "finished": 0, "waiting": 0}


def test_a_worker_that_is_refused_for_good_ends_the_farm_however_long_it_takes_to_say_so() -> None:
    """One just killed may leave its name in use for a while, so the first refusals do not count for all."""
    launcher, clock = Scripted(), Clock()
    supervisor = Supervisor(launcher, CAST, clock, _gives_up)
    supervisor.start()
    began_s = clock.now_s
    with pytest.raises(GaveUp, match="fly-1: why"):
        _refused_until_given_up(supervisor, launcher, clock)
    assert launcher.started.count("fly-1") == REFUSALS_MAX
    assert clock.now_s - began_s > SILENT_S


def _refused_until_given_up(supervisor: Supervisor, launcher: Scripted, clock: Clock) -> None:
    while clock.now_s < 1000.0:
        if launcher.states["fly-1"].condition == "running":
            clock.now_s += STEADY_S + 1.0 if launcher.started.count("fly-1") % 2 else 0.5
            launcher.end("fly-1", "refused")
        supervisor.poll()
        clock.now_s += 0.1


@pytest.mark.parametrize("condition", ["killed", "unavailable", "again"])
def test_a_worker_that_dies_otherwise_is_started_again_for_ever(condition: Condition) -> None:
    launcher, clock = Scripted(), Clock()
    supervisor = Supervisor(launcher, CAST, clock, _gives_up)
    supervisor.start()
    while launcher.started.count("fly-1") < 3 * REFUSALS_MAX:
        launcher.end("fly-1", condition)
        supervisor.poll()
        clock.now_s += BACK_OFF_MAX_S + 0.1
        supervisor.poll()


def _broken_again_and_again(names: tuple[str, ...], rounds: int) -> Scripted:
    """Let the named ones of two simulators break, again and again, soon after each start."""
    launcher, clock = Scripted(), Clock()
    supervisor = Supervisor(launcher, (*CAST, RoleSpec(kind="fly", name="fly-2")), clock, _gives_up)
    supervisor.start()
    for _ in range(rounds):
        for name in names:
            launcher.end(name, "broken")
        supervisor.poll()
        clock.now_s += BACK_OFF_MAX_S + 0.1
        supervisor.poll()
    return launcher


def test_a_farm_ends_when_all_workers_of_a_stage_break_again_and_again() -> None:
    with pytest.raises(GaveUp, match=r"fly-[12]: why"):
        _broken_again_and_again(("fly-1", "fly-2"), BREAKS_MAX)


def test_a_worker_that_breaks_is_started_again_for_ever_while_another_of_its_stage_works() -> None:
    launcher = _broken_again_and_again(("fly-1",), 3 * BREAKS_MAX)
    assert launcher.started.count("fly-1") > 2 * BREAKS_MAX
