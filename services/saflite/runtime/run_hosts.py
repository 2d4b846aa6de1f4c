"""Which model servers a run's own user named as it was made: only those may have a key as it is taken up again.

What the books of a run say of its scorer may be a stranger's word, or that of whoever ordered another scorer over the
bus. So the hosts stand beside the books, with this user's mark (`evidence/own_runs.py`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import msgspec

from saflite.contract import wire
from saflite.contract.config import ScorerConfig
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.outside import TEXT_BYTES_MAX, read_bytes
from saflite.evidence import own_runs
from saflite.scorer_pool.key_hosts import KEY_HOSTS, hosts_named_by, may_have_key

log = logging.getLogger(__name__)

FILE, MARK = "key_hosts.json", "key_hosts.mark"


def note(run_dir: Path, scorer: ScorerConfig) -> None:
    """Note the hosts that the campaign names which a run is made of; raises Unavailable if the disk fails."""
    hosts = hosts_named_by(scorer)
    if not hosts:
        return
    noted = msgspec.json.encode(hosts)
    try:
        (run_dir / FILE).write_bytes(noted)
        own_runs.mark(run_dir / MARK, noted)
    except OSError as fault:
        raise Unavailable(f"{run_dir}: {fault}") from fault


def of(run_dir: Path, scorer: ScorerConfig) -> tuple[str, ...]:
    """Return the hosts that a run's scorers may send a key to beside those of the environment; tells of the others."""
    named, ours = hosts_named_by(scorer), _noted(run_dir)
    for host in (host for host in named if host not in ours and not may_have_key(host, default_url="")):
        why = "no campaign that this user began here names it"
        log.warning("no key is sent to %s (%s): %s; %s=%s lets it be sent", host, run_dir, why, KEY_HOSTS, host)
    return tuple(host for host in named if host in ours)


def _noted(run_dir: Path) -> Sequence[str]:
    try:
        noted = read_bytes(run_dir / FILE, "list of hosts", TEXT_BYTES_MAX)
        return wire.unpack_json(noted, tuple[str, ...]) if own_runs.is_marked(run_dir / MARK, noted) else ()
    except (Refused, *wire.UNREADABLE):
        return ()
