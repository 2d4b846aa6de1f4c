"""Finding the farm a command is meant for: the run folder named, the newest one that works, or an endpoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from saflite.console.view import out
from saflite.contract.errors import FarmError, Refused
from saflite.contract.plain import argument

if TYPE_CHECKING:
    from saflite.runtime.client import FarmClient

RUNS = Path("runs")


def is_running(run_dir: Path) -> bool:
    """Return whether a farm works in a run folder: its books hold their lock, or its launcher is alive.

    The lock tells of a farm in a container, too. The launcher tells of one whose books begin, or begin anew.
    """
    from saflite.campaign.storage.sqlite import in_use
    from saflite.runtime.client import FARM_FILE, Copied, read_info
    from saflite.simulator_worker.processes import identity

    if not (run_dir / FARM_FILE).exists():
        return False
    try:
        info = read_info(run_dir)
    except Copied:
        return False
    return in_use(run_dir) or ("" != info.launcher == identity(info.pid))


def running() -> list[Path]:
    """Return the run folders in which farms work, the newest first: those below `runs/`, else this user's elsewhere.

    Who works in a folder means what runs there, whatever was begun in another one since.
    """
    from saflite.runtime import farm_register
    from saflite.runtime.client import FARM_FILE

    below, noted = [path.parent for path in RUNS.glob(f"*/{FARM_FILE}")], list(map(_shown, farm_register.noted()))
    near = {*below, *(place for place in noted if place.is_relative_to(RUNS))}
    for places in (near, {*noted} - near):
        found = [place for place in places if says_it_runs(place)]
        if found:
            return sorted(found, key=lambda place: _changed_s(place / FARM_FILE), reverse=True)
    return []


def newest_running() -> Path:
    """Return the newest farm of `running`, for what only reads; raises Refused if there is none."""
    return _some(running())[0]


def only_running() -> Path:
    """Return the one farm of `running`, for orders; raises Refused if there is none, or several may be meant."""
    place, *others = _some(running())
    if others:
        got = f"several that run: {', '.join(map(str, (place, *others)))}"
        raise Refused("run folder", expected="the one that the order is for", got=got, fix="name it")
    return place


def _some(found: list[Path]) -> list[Path]:
    if found:
        return found
    fix = "name its run folder, or --connect and --campaign"
    raise Refused("run folder", where=str(RUNS), expected="one with a running farm", got="none", fix=fix)


def says_it_runs(place: Path) -> bool:
    """As `is_running`; a run whose file of it is damaged is none, and keeps no other from being found."""
    try:
        return is_running(place)
    except FarmError:
        return False


def _changed_s(path: Path) -> float:
    """Return when a file was written, before all others for one that has gone meanwhile."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _shown(path: Path) -> Path:
    """Return a path as seen from here, if it lies below."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def newest(given: Path | None) -> Path:
    """Return the run folder given, or the newest run, and say which: the one that works, else the last below `runs/`.

    Raises Refused if there is none.
    """
    if given is not None:
        return given
    try:
        return _told(newest_running(), "the newest that runs")
    except Refused:
        return _told(_last(lambda _place: True, "a run"), "the newest")


def newest_at_rest(given: Path | None) -> Path:
    """Return the run folder given, or the last below `runs/` that no farm works on, and say which.

    For what cannot or should not be done to a running one. Raises Refused if there is none.
    """
    if given is not None:
        return given
    return _told(_last(lambda place: not says_it_runs(place), "a run that no farm works on"), "the newest at rest")


def _last(fits: Callable[[Path], bool], expected: str) -> Path:
    found = [path for path in RUNS.glob("*/books.sqlite") if fits(path.parent)]
    if not found:
        raise Refused("run folder", where=str(RUNS), expected=expected, got="none", fix="name a run folder")
    return max(found, key=_changed_s).parent


def _told(place: Path, which: str) -> Path:
    out.complain("note", f"no RUN was named: {place} is meant, {which}")
    return place


def last_as_run(words: Sequence[str]) -> tuple[list[str], Path | None]:
    """Split words of which the last one may be a run folder: one with a slash, or a folder that is there."""
    if words and ("/" in words[-1] or Path(words[-1]).is_dir()):
        return list(words[:-1]), Path(words[-1])
    return list(words), None


class Where(NamedTuple):
    """The farm a command is meant for: at an endpoint (one campaign of those there), or that of a run folder."""

    run_dir: Path | None
    endpoint: str = ""
    campaign: str = ""
    insecure: bool = False
    keys: Path | None = None


def connect(where: Where, *, reads: bool = False) -> FarmClient:
    """Return a client of the farm meant; of one that is not named the newest will do for what only `reads`.

    Raises:
        Refused: none is named or running, or an order might be meant for several.
        Unavailable: it is not reached.
    """
    from saflite.bus.keyring import peer_credentials
    from saflite.runtime.client import FarmClient
    from saflite.runtime.clock import WallClock

    if where.endpoint:
        keys = peer_credentials(where.keys, WallClock().unix_s()) if where.keys is not None else None
        return FarmClient.connect(where.endpoint, where.campaign, insecure=where.insecure, keys=keys)
    place = where.run_dir
    if place is None:
        place = _told(newest_running(), "the newest that runs") if reads else _told(only_running(), "the one that runs")
    if not is_running(place):
        fix = f"`saflite resume {argument(place)}` goes on with it"
        raise Refused("run folder", where=str(place), expected="a running farm", got="none that runs", fix=fix)
    return FarmClient.of_run(place, insecure=where.insecure)
