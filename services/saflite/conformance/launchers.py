"""What every launcher promises: roles run, end, and are told of. Starts real ones (routers, books that are refused).

from saflite.conformance.kit import findings
from saflite.conformance.launchers import check_launcher

assert findings(check_launcher(open_launcher)) == []      # open_launcher(meeting) -> a launcher for the roles of it
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterable
from functools import partial

from saflite.bus.base import Happening
from saflite.bus.endpoints import free_endpoint
from saflite.bus.zenoh import open_client
from saflite.conformance.kit import Check
from saflite.contract.errors import Refused, Unavailable
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.base import Condition, Launcher, Meeting, RoleSpec

Factory = Callable[[Meeting], Launcher]
Promise = Callable[[Factory], None]

PATIENCE_S = 120.0  # only what hangs is given up: a Ray actor of a busy machine takes tens of seconds to start
POLL_S = 0.05
ROUTER = RoleSpec(kind="router", name="router", listens=True)
NO_BOOKS = RoleSpec(kind="books", name="no-books")  # books without a run folder are refused


def what_runs_does_its_work_and_stop_ends_it(factory: Factory) -> None:
    """A router that was started answers; after `stop` it does not, and the launcher knows of nothing any more."""
    meeting = _meeting()
    launcher = factory(meeting)
    try:
        launcher.start(ROUTER)
        _reach(meeting)
        assert launcher.poll()["router"].condition == "running", "a role that answers is not said to run"
        launcher.stop(["router"])
        assert not _answers(meeting), "a role that was stopped still answers"
        assert launcher.poll() == {}, "a role that was stopped is still told of"
    finally:
        launcher.stop()


def a_name_runs_once(factory: Factory) -> None:
    """A second role of a name is refused while the first runs, and the first is not harmed."""
    meeting = _meeting()
    launcher = factory(meeting)
    try:
        launcher.start(ROUTER)
        _reach(meeting)
        try:
            launcher.start(ROUTER)
        except Refused:
            pass
        else:
            raise AssertionError("a second role of the same name was started")
        assert _answers(meeting), "the first of its name was harmed"
    finally:
        launcher.stop()


def how_a_role_ended_is_told_and_it_may_start_again(factory: Factory) -> None:
    """A role that is refused is told as refused, in words, until it is started again."""
    launcher = factory(_meeting())
    try:
        for _ in range(2):
            launcher.start(NO_BOOKS)
            _await(launcher, NO_BOOKS.name, "refused")
            assert launcher.poll()[NO_BOOKS.name].message, "a role was refused, and nothing says why"
    finally:
        launcher.stop()


def each_role_has_its_own_state(factory: Factory) -> None:
    """The end of one role changes nothing for another; stopping one leaves the other running."""
    meeting = _meeting()
    launcher = factory(meeting)
    try:
        launcher.start(ROUTER)
        launcher.start(NO_BOOKS)
        _await(launcher, NO_BOOKS.name, "refused")
        _reach(meeting)
        assert set(launcher.poll()) == {ROUTER.name, NO_BOOKS.name}, "not exactly the roles started are told of"
        launcher.stop([NO_BOOKS.name])
        assert {name: state.condition for name, state in launcher.poll().items()} == {ROUTER.name: "running"}
        assert _answers(meeting), "a role died with another"
    finally:
        launcher.stop()


def a_role_that_is_drained_ends_and_is_told_as_finished(factory: Factory) -> None:
    """A worker that is needed no more ends by itself; another of its kind goes on, and unknown names are no fault."""
    launcher = factory(_meeting())
    try:
        for name in ("judge-1", "judge-2"):
            launcher.start(RoleSpec(kind="judge", name=name))
        launcher.drain(["judge-1", "nobody"])
        _await(launcher, "judge-1", "finished")
        assert launcher.poll()["judge-2"].condition == "running", "a role ended with another that was drained"
    finally:
        launcher.stop()


def stop_is_harmless_where_nothing_runs(factory: Factory) -> None:
    """Stopping nothing, names nobody knows, or twice is no fault; a launcher works on afterwards."""
    meeting = _meeting()
    launcher = factory(meeting)
    launcher.stop()
    launcher.stop(["nobody"])
    try:
        launcher.start(ROUTER)
        _reach(meeting)
    finally:
        launcher.stop()
        launcher.stop()
    assert launcher.poll() == {}, "a stopped launcher still tells of roles"


def a_module_nobody_knows_is_refused(factory: Factory) -> None:
    """A role that names a module the launcher was not given is refused, not started without it."""
    launcher = factory(_meeting())
    try:
        launcher.start(RoleSpec(kind="fly", name="fly-1", modules=("no-such-module",)))
    except Refused:
        return
    finally:
        launcher.stop()
    raise AssertionError("a role was started without a module it needs")


def check_launcher(factory: Factory) -> tuple[Check, ...]:
    """Return the checks of a launcher; each makes one of its own and stops what it started."""
    promises: tuple[Promise, ...] = (
        what_runs_does_its_work_and_stop_ends_it,
        a_name_runs_once,
        how_a_role_ended_is_told_and_it_may_start_again,
        each_role_has_its_own_state,
        a_role_that_is_drained_ends_and_is_told_as_finished,
        stop_is_harmless_where_nothing_runs,
        a_module_nobody_knows_is_refused,
    )
    return tuple(Check(promise.__name__.replace("_", " "), partial(_kept, promise, factory)) for promise in promises)


def _kept(promise: Promise, factory: Factory) -> Iterable[str]:
    promise(factory)
    return ()


def _meeting() -> Meeting:
    return Meeting(campaign="conformance", connect=free_endpoint(), insecure=True)  # as across machines


def _answers(meeting: Meeting) -> bool:
    try:
        client = open_client("conformance", meeting.connect, patience_s=2.0, insecure=meeting.insecure)
    except Unavailable:
        return False
    replies: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    client.ask("saflite/conformance", b"", 0, replies.put, 1.0)
    replies.get()  # nobody serves it: the router says so
    client.close()
    return True


def _reach(meeting: Meeting) -> None:
    clock = WallClock()
    until_s = clock.monotonic_s() + PATIENCE_S
    while not _answers(meeting):
        assert clock.monotonic_s() < until_s, f"a router that was started does not answer within {PATIENCE_S:.0f} s"


def _await(launcher: Launcher, name: str, condition: Condition) -> None:
    clock = WallClock()
    until_s = clock.monotonic_s() + PATIENCE_S
    while (state := launcher.poll()[name]).condition != condition:
        assert state.condition == "running", f"{name} is {state.condition}, not {condition}: {state.message}"
        assert clock.monotonic_s() < until_s, f"{name} is not {condition} within {PATIENCE_S:.0f} s"
        clock.sleep_s(POLL_S)
