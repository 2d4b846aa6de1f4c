"""What starts the roles of a farm somewhere: on this machine, on a cluster, on a machine reached by other means.

A launcher is told what to run and says how it goes. Process ids, paths and machines are its own business, so whoever
supervises a farm (`runtime/supervisor.py`) works with any launcher. `saflite.conformance.launchers` holds the checks
every launcher passes.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal, NamedTuple, Protocol

import msgspec

from saflite.contract.work import Stage

Kind = Stage | Literal["books", "router"]
Condition = Literal["running", "finished", "refused", "unavailable", "unanswered", "killed", "again", "broken"]
"""How a role is: `finished` by itself as it should, `refused` for its input, `unavailable` for want of something it
needs, `unanswered` when its patience with a farm that is away ended, `killed` from outside,
`again` when it asks to be started anew, `broken` by its own fault."""


class RoleSpec(msgspec.Struct, frozen=True, kw_only=True):
    """What to run. `name` is the worker's name, unique in the farm; `listens` for the role that holds the router.

    `modules` names modules from outside the package (targets, strategies, ...) the role may need; where they lie is
    for the launcher to know. `labels` say something of the role that others may want to know, such as its site.
    """

    kind: Kind
    name: str
    listens: bool = False
    modules: tuple[str, ...] = ()
    labels: dict[str, str] = {}


class Meeting(msgspec.Struct, frozen=True, kw_only=True):
    """Where the roles of one farm meet: the campaign, and the endpoints at which the router is reached and listens.

    `gate` is a second endpoint at which the router listens, for those who prove their name by a key.
    `insecure` allows endpoints that others can reach. Workers end by themselves after `patience_s` without
    an answer of the books; 0 lets them try without end. `json_logs`: logs are for machines (`runtime/log_lines.py`).
    """

    campaign: str
    connect: str
    listen: str = ""
    gate: str = ""
    insecure: bool = False
    patience_s: float = 0.0
    json_logs: bool = False


class RoleState(NamedTuple):
    """How a role is, and what it said last if it has ended."""

    condition: Condition
    message: str = ""


class Launcher(Protocol):
    """Runs the roles of one farm. Used from one thread; never waits, except in `stop`."""

    def start(self, spec: RoleSpec) -> None:
        """Run a role; one that has ended may be started again.

        Raises:
            Refused: a role of that name is running, or the launcher does not know a module named.
            Unavailable: there is no room for it now.
        """
        ...

    def poll(self) -> dict[str, RoleState]:
        """Return the state of every role started and not stopped, by name."""
        ...

    def drain(self, names: Collection[str]) -> None:
        """Ask workers to take no more work, finish what they hold and end; `poll` tells when they have.

        One that has not begun ends at once. Names nobody knows are no fault.
        """
        ...

    def stop(self, names: Collection[str] | None = None) -> None:
        """End the roles named, or all, and forget them: asked first, so that they hand back what they hold.

        Nothing they started is left when this returns. Names nobody knows are no fault.
        """
        ...
