"""A group of workers for a farm that runs elsewhere: finds its campaign, starts workers here, keeps them running."""

from __future__ import annotations

import logging
import re
import shutil
import socket
import tempfile
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import NamedTuple

import msgspec

from saflite.bus.access import STAGE_OF, Peer, speaks_for
from saflite.bus.endpoints import check_endpoint
from saflite.bus.keyring import Credentials, peer_credentials
from saflite.bus.zenoh import open_client
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.ids import short_id
from saflite.contract.join import check_worker_name
from saflite.contract.work import Stage
from saflite.runtime.campaign_runner import interrupts
from saflite.runtime.clock import WallClock
from saflite.runtime.discovery import LOOK_S, campaigns, only_campaign
from saflite.runtime.launchers.base import Condition, Meeting, RoleSpec, RoleState
from saflite.runtime.launchers.local import LocalLauncher
from saflite.runtime.metrics import Endpoint, GroupMetrics
from saflite.runtime.process_limits import prepare_limits
from saflite.runtime.supervisor import Failures, GaveUp, Supervisor

log = logging.getLogger(__name__)

POLL_S = 0.25
FAILURES_MAX = 3  # workers that cannot work here this often in a row end the group
BREAKS_MAX = 20  # all workers of a stage, broken this often in a row, do so too

Say = Callable[[str], None]


class Group(msgspec.Struct, frozen=True, kw_only=True):
    """Which workers to run, for which farm. `workers` says how many of each stage; `name` begins all their names.

    `keys` is the folder that proves who they are, where the endpoint wants that: its name begins theirs, then.
    `metrics` is where they are told over HTTP, if anywhere, and `json_logs` says that logs are for machines.
    `folder` holds their logs and undelivered results; None takes a temporary one.
    """

    endpoint: str
    workers: dict[Stage, int]
    campaign: str = ""
    name: str = ""
    folder: Path | None = None
    modules: tuple[Path, ...] = ()
    labels: dict[str, str] = {}
    keys: Path | None = None
    insecure: bool = False
    patience_s: float = 60.0
    metrics: str = ""
    json_logs: bool = False


class GroupEnd(NamedTuple):
    """How a group ended: `finished` when the campaign is over or it was stopped, else as the role that gave up."""

    condition: Condition
    message: str


def run(group: Group, say: Say) -> GroupEnd:
    """Run the group to its end; `say` is told what a person wants to know.

    Raises:
        Refused: an endpoint that needs `insecure`, illegal names, no campaign or several at the endpoint, or too few
            open files or too little memory allowed here.
        Unavailable: nobody answers at the endpoint within the patience.
    """
    prepare_limits()
    endpoint = check_endpoint(
        group.endpoint, insecure=group.insecure, keys=group.keys is not None, argument="--join"
    ).from_here
    keys = peer_credentials(group.keys, WallClock().unix_s()) if group.keys is not None else None
    peer = keys.peer if keys is not None else None
    if peer is not None:
        _check_key(peer, group)
    folder = group.folder or Path(tempfile.mkdtemp(prefix="saflite-worker-"))
    end: GroupEnd | None = None
    try:
        specs = _specs(group, group.name or _name_here(folder, peer.name if peer is not None else ""))
        campaign = group.campaign or _campaign_at(endpoint, group, keys)
        if peer is not None and not peer.may(campaign):
            raise Refused("campaign", expected=f"one the key is for: {peer.in_words()}", got=repr(campaign))
        meeting = Meeting(
            campaign=campaign,
            connect=endpoint,
            insecure=group.insecure,
            patience_s=group.patience_s,
            json_logs=group.json_logs,
        )
        say(f"joining campaign {campaign} at {endpoint}: {', '.join(spec.name for spec in specs)}")
        say(f"logs in {folder / 'logs'}")
        with interrupts() as interrupted:
            launcher = LocalLauncher(meeting, folder, modules=group.modules, keys=group.keys)
            end = _work(launcher, specs, interrupted, group.metrics)
        if end.condition == "unanswered":
            end = end._replace(message=f"{end.message}{_why_unanswered(endpoint, campaign, group, keys)}")
    finally:
        _tidy(group, folder, end)
    return end


def _work(launcher: LocalLauncher, specs: Sequence[RoleSpec], interrupted: list[str], metrics: str) -> GroupEnd:
    supervisor = Supervisor(launcher, specs, WallClock(), _gives_up)
    told = GroupMetrics(lambda: (supervisor.counts(), supervisor.restarts))
    try:
        with Endpoint(metrics, told) if metrics else nullcontext():
            return _follow(supervisor, interrupted, WallClock())
    finally:
        supervisor.stop()
        launcher.stop()


def _follow(supervisor: Supervisor, interrupted: list[str], clock: WallClock) -> GroupEnd:
    supervisor.start()
    while not supervisor.over:
        if interrupted:
            return GroupEnd("finished", f"{interrupted[0]}: leases are handed back")
        try:
            supervisor.poll()
        except GaveUp as fault:
            return GroupEnd(fault.state.condition, str(fault))
        clock.sleep_s(POLL_S)
    return GroupEnd("finished", "the campaign is over")


def _gives_up(_: RoleSpec, state: RoleState, failures: Failures) -> bool:
    if state.condition == "broken":
        return failures.of_all >= BREAKS_MAX
    at_once = state.condition in ("refused", "unanswered")
    return at_once or (state.condition == "unavailable" and failures.its_own >= FAILURES_MAX)


def _specs(group: Group, name: str) -> list[RoleSpec]:
    modules = tuple(path.name for path in group.modules)
    return [
        RoleSpec(kind=stage, name=check_worker_name(f"{name}-{stage}-{number}"), modules=modules, labels=group.labels)
        for stage, count in group.workers.items()
        for number in range(1, count + 1)
    ]


def _check_key(peer: Peer, group: Group) -> None:
    """Raise Refused for what the key is not for: the farm would not answer."""
    allowed = [STAGE_OF[role] for role in peer.counting if role in STAGE_OF]
    wrong = [stage for stage in group.workers if stage not in allowed]
    if wrong:
        raise Refused("--stages", expected=f"{','.join(allowed) or 'none'}: {peer.in_words()}", got=",".join(wrong))
    if group.name and not speaks_for(peer.name, group.name):
        raise Refused("--name", expected=f"{peer.name} or {peer.name}-..., as the key is named", got=repr(group.name))


def _name_here(folder: Path, peer: str = "") -> str:
    """Return a name that is the same for the same host and folder, so that results left there find their worker."""
    host = peer or re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname()).strip("-")[:32] or "host"
    return f"{host}-{short_id(str(folder.absolute()).encode())[:6]}"


def _tidy(group: Group, folder: Path, end: GroupEnd | None) -> None:
    """Remove a temporary folder, unless it holds results nobody took or tells why the group ended."""
    left = any((folder / "spool").rglob("*.report"))
    if group.folder is None and not left and (end is None or end.condition == "finished"):
        with suppress(OSError):
            shutil.rmtree(folder)


def _campaign_at(endpoint: str, group: Group, keys: Credentials | None) -> str:
    bus = open_client("worker", endpoint, patience_s=group.patience_s or None, insecure=group.insecure, keys=keys)
    try:
        return only_campaign(bus, endpoint, group.patience_s)
    finally:
        bus.close()


def _why_unanswered(endpoint: str, campaign: str, group: Group, keys: Credentials | None) -> str:
    """Return what can be seen of why nobody answered for a campaign, to be said after that; empty if nothing."""
    try:
        bus = open_client("worker", endpoint, patience_s=LOOK_S, insecure=group.insecure, keys=keys)
    except Unavailable as fault:
        return f"; {fault}"
    try:
        found = campaigns(bus, WallClock(), LOOK_S)
    finally:
        bus.close()
    return f"; at {endpoint} runs {', '.join(found)}" if found and campaign not in found else ""
