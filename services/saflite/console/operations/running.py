"""Starting, following and ending a campaign on this machine, as `run` and `resume` share it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec

from saflite.campaign.storage.own_folder import STORE
from saflite.console.run_data.conclusion import conclude
from saflite.console.view import live, out
from saflite.contract.config import Campaign
from saflite.contract.control import Status
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.plain import argument
from saflite.contract.target_info import TargetInfo
from saflite.runtime.clock import WallClock
from saflite.runtime.metrics import Endpoint, FarmMetrics

if TYPE_CHECKING:
    from saflite.runtime.campaign_runner import ExitSummary

RUNS = Path("runs")
P = ParamSpec("P")
Start = Callable[[Callable[[Status], None]], "ExitSummary"]


def free_folder(name: str) -> Path:
    """Return the first of runs/NAME, runs/NAME-2, ... that does not exist."""
    number = 1
    while True:
        folder = RUNS / (name if number == 1 else f"{name}-{number}")
        if not folder.exists():
            return folder
        number += 1


def check_new(folder: Path) -> None:
    """Raise Refused if a run folder exists: nothing is ever written over."""
    if os.path.lexists(folder):  # a link to nowhere, too
        goes_on = f"`saflite resume {argument(folder)}` goes on with it; " if (folder / STORE).exists() else ""
        got, fix = "a run" if goes_on else "something there", f"{goes_on}choose another --out"
        raise Refused("--out", where=str(folder), expected="a folder that does not exist", got=got, fix=fix)


def create(run_dir: Path, campaign: Campaign, target: TargetInfo) -> None:
    """Make the run folder, whole or not at all: the books, the campaign as it is run, the software that runs it.

    Raises:
        Refused: a run stands there already.
        Unavailable: the disk refuses.
    """
    from saflite.campaign.presets.campaigns import template
    from saflite.campaign.storage.store import Store
    from saflite.console.io.toml_text import dump
    from saflite.console.run_data import provenance
    from saflite.contract.modules import all_given
    from saflite.runtime import run_hosts, run_modules

    made = not run_dir.exists()
    store = Store.create(run_dir, campaign, template(campaign, target.build), target)
    try:
        store.close()
        (run_dir / "campaign.toml").write_text(dump(campaign), encoding="utf-8")
        provenance.note(run_dir, target)
        run_modules.note(run_dir, all_given())
        run_hosts.note(run_dir, campaign.scorer)
    except BaseException as fault:
        if made:  # or the next try would be refused because of what is left of this one
            shutil.rmtree(run_dir, ignore_errors=True)
        if isinstance(fault, OSError):
            raise Unavailable(f"{run_dir}: {fault}") from fault
        raise


def check_books(run_dir: Path, *, accept_loss: bool) -> None:
    """Raise Refused if the books cannot be taken up again (`resume_faults`), unless what is wrong is accepted.

    A run in use is not looked at.
    """
    from saflite.campaign.storage.audit import resume_faults
    from saflite.campaign.storage.sqlite import in_use
    from saflite.campaign.storage.witness import FIX
    from saflite.runtime import campaign_runner

    if in_use(run_dir):
        return
    problems = resume_faults(run_dir)
    if not problems:
        return
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if not accept_loss:
        where = str(run_dir / "books.sqlite")
        raise Refused("books", where=where, expected="books that balance", got=problems[0] + more, fix=FIX)
    for problem in problems:
        out.complain("warning", f"accepted: {problem}")
    campaign_runner.accept_loss(run_dir, problems[0] + more)


def is_concluded(run_dir: Path) -> bool:
    """Return whether nothing is left to do for a run: its campaign is over by its journal, and reported since.

    Not whether its books are sealed: those that were killed once are not, though they go on to their end.

    Raises:
        Refused: what is read of it is damaged.
    """
    from saflite.campaign.storage.audit import is_over
    from saflite.console.run_data.reporting import is_reported
    from saflite.console.run_data.run_folder import open_run

    with open_run(run_dir) as run:  # a report may be of an earlier sitting, and the last was killed before its own
        if not is_reported(run):
            return False
    return is_over(run_dir)


def follow(run_dir: Path, start: Start, *, as_json: bool, metrics: str = "") -> int:
    """Run a farm with its progress shown, and told at `metrics` if that is an address; returns the exit code."""
    with ExitStack() as opened:
        told = FarmMetrics(WallClock())
        if metrics:
            opened.enter_context(Endpoint(metrics, told))
        view = live.open_view(run_dir, quiet=as_json)
        opened.callback(_unless_gone(view.close))  # whoever reads keeps the write-ahead log there
        show = _unless_gone(view.update)

        def on_status(status: Status) -> None:
            told.update(status)
            show(status)

        ended = start(on_status)
    try:
        return _end(run_dir, ended, as_json=as_json)
    except KeyboardInterrupt as fault:
        left = f"what was flown is kept; `{out.program()} report {argument(run_dir)}` writes the report"
        raise KeyboardInterrupt(f"stopped by the keyboard after the last flight; {left}") from fault


def _end(run_dir: Path, ended: ExitSummary, *, as_json: bool) -> int:
    from saflite.campaign.storage.seal import seal, seal_file
    from saflite.campaign.storage.sqlite import in_use, make_one_file
    from saflite.campaign.storage.store import store_file

    if not in_use(run_dir) and seal_file(run_dir).exists():  # without one it is not known to be whole
        make_one_file(store_file(run_dir))
        seal(run_dir)
    return conclude(run_dir, ended, as_json=as_json)


def _unless_gone(show: Callable[P, None]) -> Callable[P, None]:
    """Return what shows nothing to a terminal or reader that has gone: the campaign goes on, or ends, all the same."""

    def shown(*args: P.args, **named: P.kwargs) -> None:
        with suppress(OSError):
            show(*args, **named)

    return shown
