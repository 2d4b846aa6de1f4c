"""Where the workers of a campaign run: on this machine, or on a Ray cluster; the books stay with the run folder."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from saflite.bus.access import STAGE_OF
from saflite.bus.keyring import AUTHORITY_KEY, PEERS, add, counts, read_register
from saflite.contract.config import environment, set_environment
from saflite.contract.errors import Refused, not_installed
from saflite.runtime.clock import WallClock
from saflite.runtime.farm import Elsewhere
from saflite.scorer_pool.key_hosts import with_key_hosts

HERE, RAY = "here", "ray"
KEY_NAME = "ray"
KEY_DAYS = 30
HEAD_AWAY, HEAD_AWAY_S = "RAY_gcs_rpc_server_reconnect_timeout_s", 7 * 86_400
EXPECTED = "here, ray (a cluster started on this machine), ray:auto or ray:ADDRESS"


class Workers(NamedTuple):
    """Workers of a cluster: how many cores it has, how their names begin, and what starts them."""

    cores: int
    prefix: str
    launcher: Elsewhere


def check_place(place: str, *, listen: str) -> None:
    """Raise Refused for a place that is none, or one whose workers could not reach the farm."""
    kind, _, address = place.partition(":")
    if place == HERE:
        return
    if kind != RAY or (":" in place and not address):
        raise Refused("--on", expected=EXPECTED, got=repr(place))
    if find_spec("ray") is None:
        raise not_installed("Ray is", "ray")
    if address and not listen:
        fix = "add --listen tls/HOST:PORT --keys FOLDER (see `saflite keys`)"
        raise Refused(
            "--on", expected="--listen with a cluster: its nodes have to reach the farm", got=repr(place), fix=fix
        )


def workers_on(
    place: str, campaign: str, *, modules: Sequence[Path], keys: Path | None, key_hosts: Sequence[str]
) -> Workers:
    """Join the cluster and return what starts workers there.

    Raises:
        Refused: there are keys, but none for the cluster's workers.
        Unavailable: no cluster is reached.
    """
    address = place.partition(":")[2]
    if not address:
        _close_to_others()
    _outlive_its_head()
    from saflite.runtime.launchers.base import Meeting
    from saflite.runtime.launchers.ray import RayLauncher, connect

    key = _key(keys, campaign) if keys is not None else None
    cores = connect(address)

    def launcher(meeting: Meeting) -> RayLauncher:
        return RayLauncher(
            meeting,
            address,
            modules=modules,
            keys=key,
            variables_of=lambda spec: with_key_hosts(key_hosts) if spec.kind == "score" else {},
        )

    return Workers(max(1, cores), f"{KEY_NAME}-", launcher)


def _close_to_others() -> None:
    """Let a cluster that is started here ask for a token; Ray looks for it once, as it is imported (2.60)."""
    if not environment("RAY_AUTH_MODE"):
        set_environment("RAY_AUTH_MODE", "token")
        set_environment("RAY_AUTH_TOKEN", secrets.token_hex(32))


def _outlive_its_head() -> None:
    """Have Ray leave this process alone where its head does not answer: it would end it after 60 s, with code 1."""
    if not environment(HEAD_AWAY):
        set_environment(HEAD_AWAY, str(HEAD_AWAY_S))


def _key(keys: Path, campaign: str) -> Path:
    """Return the folder of the key that the cluster's workers show; made where the authority's key is at hand."""
    peer, now_s = read_register(keys).named(KEY_NAME), WallClock().unix_s()
    if peer is not None and peer.may(campaign) and counts(peer, now_s):
        return keys / PEERS / KEY_NAME
    if not (keys / AUTHORITY_KEY).exists():
        roles = " ".join(f"--role {role}" for role in STAGE_OF)
        fix = f"`saflite keys add {KEY_NAME} {roles}` where the authority's key is"
        raise Refused("--keys", where=str(keys), expected=f"a key named {KEY_NAME}", got="none that counts", fix=fix)
    return add(keys, KEY_NAME, tuple(STAGE_OF), now_s=now_s, days=KEY_DAYS, if_needed=True)  # or another farm just did
