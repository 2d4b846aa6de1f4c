"""Keeps the roles of a farm running over any launcher: starts them, starts again what died, after a back-off."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from typing import Literal, NamedTuple

from saflite.contract.clock import Clock
from saflite.contract.errors import Unavailable
from saflite.runtime.launchers.base import Kind, Launcher, RoleSpec, RoleState

log = logging.getLogger(__name__)

BACK_OFF_FIRST_S, BACK_OFF_MAX_S = 0.2, 5.0
STEADY_S = 10.0  # a role that lived this long starts its back-off anew
CENTRE: tuple[Literal["books", "router"], ...] = ("books", "router")


class Failures(NamedTuple):
    """How often a role ended in a row, each time soon after its start; and the least of that among all of its kind."""

    its_own: int
    of_all: int


GivesUp = Callable[[RoleSpec, RoleState, Failures], bool]
"""Whether a role that ended so, after so many failures, is not started again."""


class GaveUp(Exception):
    """A role is not started again; nothing else was stopped yet."""

    def __init__(self, spec: RoleSpec, state: RoleState) -> None:
        self.spec, self.state = spec, state
        super().__init__(f"{spec.name}: {state.message}")


class _Role:
    """A role and its back-off."""

    def __init__(self, spec: RoleSpec) -> None:
        self.spec = spec
        self.running = self.finished = False
        self.started_s, self.start_at_s, self.wait_s = 0.0, 0.0, BACK_OFF_FIRST_S
        self.failures = 0
        self.leaving = False

    def failures_at(self, now_s: float) -> int:
        """Return how often it ended in a row; none of that counts once it runs steadily or has done its work."""
        steady = self.finished or (self.running and now_s - self.started_s > STEADY_S)
        return 0 if steady else self.failures


class Supervisor:
    """The roles of one farm, or those of one group of workers. Call `poll` often."""

    def __init__(self, launcher: Launcher, specs: Sequence[RoleSpec], clock: Clock, gives_up: GivesUp) -> None:
        self._launcher, self._clock, self._gives_up = launcher, clock, gives_up
        self._roles = {spec.name: _Role(spec) for spec in specs}
        assert len(self._roles) == len(specs), "two roles of one name"
        self.restarts = 0

    def start(self) -> None:
        """Start every role."""
        for role in self._roles.values():
            self._start(role)

    def poll(self) -> bool:
        """Start again what died and has served its back-off; True if anything changed.

        Raises:
            GaveUp: a role is not worth another try.
        """
        now_s = self._clock.monotonic_s()
        changed = False
        for name, state in self._launcher.poll().items():
            role = self._roles[name]
            if role.running and state.condition != "running":
                if role.leaving:
                    self._left(role)
                else:
                    self._ended(role, state, now_s)
                changed = True
        for role in self._roles.values():
            if not role.running and not role.finished and now_s >= role.start_at_s:
                self.restarts += 1
                self._start(role)
                changed = True
        return changed

    def working(self, kind: Kind) -> list[str]:
        """Return the names of the roles of a kind that are to work: neither finished nor leaving."""
        return [
            name for name, role in self._roles.items() if role.spec.kind == kind and not role.finished | role.leaving
        ]

    def add(self, spec: RoleSpec) -> None:
        """Start one more role."""
        assert spec.name not in self._roles, f"a second {spec.name}"
        self._roles[spec.name] = _Role(spec)
        self._start(self._roles[spec.name])

    def knows(self, name: str) -> bool:
        """Return whether there is a role of that name, be it one that leaves."""
        return name in self._roles

    def drain(self, names: Collection[str]) -> None:
        """Let roles finish what they hold and leave; they are not started again, whatever becomes of them."""
        for name in names:
            role = self._roles[name]
            role.leaving = True
            if not role.running:
                self._left(role)
        self._launcher.drain(names)

    def finished(self, name: str) -> bool:
        """Return whether a role has done all it had to do."""
        return self._roles[name].finished

    def counts(self) -> dict[str, int]:
        """Return how many roles run, have finished, and wait to be started again; may be called from any thread."""
        roles = tuple(self._roles.values())
        running, finished = sum(role.running for role in roles), sum(role.finished for role in roles)
        return {"running": running, "finished": finished, "waiting": len(roles) - running - finished}

    @property
    def over(self) -> bool:
        """Whether all roles have finished."""
        return all(role.finished for role in self._roles.values())

    def stop(self) -> None:
        """Stop workers first (they hand back what they hold), then the books, then the router."""
        workers = [name for name, role in self._roles.items() if role.spec.kind not in CENTRE]
        self._launcher.stop(workers)
        for kind in CENTRE:
            self._launcher.stop([name for name, role in self._roles.items() if role.spec.kind == kind])
        for role in self._roles.values():
            role.running, role.finished = False, True

    def _start(self, role: _Role) -> None:
        role.started_s = self._clock.monotonic_s()
        try:
            self._launcher.start(role.spec)
        except Unavailable as fault:
            self._ended(role, RoleState("unavailable", str(fault)), role.started_s)
        else:
            role.running = True

    def _left(self, role: _Role) -> None:
        del self._roles[role.spec.name]
        self._launcher.stop([role.spec.name])

    def _ended(self, role: _Role, state: RoleState, now_s: float) -> None:
        role.running = False
        role.finished = state.condition == "finished"
        if role.finished:
            return
        lived = state.condition != "refused" and now_s - role.started_s > STEADY_S  # not: took long to be refused
        steady = lived or state.condition in ("killed", "again")
        role.failures = 1 if steady else role.failures + 1
        role.wait_s = BACK_OFF_FIRST_S if steady else min(2 * role.wait_s, BACK_OFF_MAX_S)
        role.start_at_s = now_s + role.wait_s
        of_all = min(one.failures_at(now_s) for one in self._roles.values() if one.spec.kind == role.spec.kind)
        if self._gives_up(role.spec, state, Failures(role.failures, of_all)):
            raise GaveUp(role.spec, state)
        how = "has ended" if state.condition == "again" else f"is {state.condition}"
        log.warning("%s %s, starting it again: %s", role.spec.name, how, state.message)
