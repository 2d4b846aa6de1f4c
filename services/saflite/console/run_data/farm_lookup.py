"""Finding the farm a command is meant for: the run folder named, the newest one that works, or an endpoint."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from saflite.contract.errors import Refused

if TYPE_CHECKING:
    from saflite.runtime.client import FarmClient

RUNS = Path("runs")


def is_running(run_dir: Path) -> bool:
    """Return whether a farm works in a run folder: its launcher is alive."""
    from saflite.runtime.client import FARM_FILE, read_info

    if not (run_dir / FARM_FILE).exists():
        return False
    try:
        os.kill(read_info(run_dir).pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def newest_running() -> Path:
    """Return the newest running farm below `runs/`; raises Refused if there is none."""
    from saflite.runtime.client import FARM_FILE

    found = [path.parent for path in RUNS.glob(f"*/{FARM_FILE}") if is_running(path.parent)]
    if not found:
        fix = "name its run folder, or --connect and --campaign"
        raise Refused("run folder", where=str(RUNS), expected="one with a running farm", got="none", fix=fix)
    return max(found, key=lambda path: (path / FARM_FILE).stat().st_mtime)


class Where(NamedTuple):
    """The farm a command is meant for: at an endpoint with its campaign, or the one that works in a run folder."""

    run_dir: Path | None
    endpoint: str = ""
    campaign: str = ""
    insecure: bool = False
    keys: Path | None = None


def connect(where: Where) -> FarmClient:
    """Return a client of the farm meant; raises Refused if none is named or running, Unavailable if not reached."""
    from saflite.bus.keyring import peer_credentials
    from saflite.runtime.client import FarmClient
    from saflite.runtime.clock import WallClock

    if where.endpoint:
        if not where.campaign:
            raise Refused("--campaign", expected="the campaign's name, with --connect", got="nothing")
        keys = peer_credentials(where.keys, WallClock().unix_s()) if where.keys is not None else None
        return FarmClient.connect(where.endpoint, where.campaign, insecure=where.insecure, keys=keys)
    place = where.run_dir or newest_running()
    if not is_running(place):
        fix = f"`saflite resume {place}` goes on with it"
        raise Refused("run folder", where=str(place), expected="a running farm", got="none that runs", fix=fix)
    return FarmClient.of_run(place)
