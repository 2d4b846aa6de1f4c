"""Starting, following and ending a campaign on this machine, as `run` and `resume` share it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console import live, out, reporting
from saflite.console.causes import causes
from saflite.console.cli import INFRASTRUCTURE
from saflite.console.run_folder import SHRINK, open_run
from saflite.contract.config import Campaign
from saflite.contract.control import Status
from saflite.contract.errors import Refused, Unavailable

if TYPE_CHECKING:
    from saflite.runtime.local import ExitSummary

RUNS = Path("runs")
SHOWN = 12
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
    if folder.exists():
        fix = f"`saflite resume {folder}` goes on with a run; choose another --out for a new one"
        raise Refused("--out", where=str(folder), expected="a folder that does not exist", got="one that does", fix=fix)


def create(run_dir: Path, campaign: Campaign) -> None:
    """Make the run folder: the books, the campaign as it is run, the software that runs it.

    Raises:
        Refused: a run stands there already.
        Unavailable: the disk refuses.
    """
    from saflite.campaign.builtin import template
    from saflite.campaign.store import Store
    from saflite.console import software
    from saflite.console.toml_text import dump

    Store.create(run_dir, campaign, template(campaign)).close()
    try:
        (run_dir / "campaign.toml").write_text(dump(campaign), encoding="utf-8")
    except OSError as fault:
        raise Unavailable(f"{run_dir}: {fault}") from fault
    software.note(run_dir)


def follow(run_dir: Path, start: Start, *, as_json: bool) -> int:
    """Run a farm with its progress shown; returns 1 if confirmed violations were found."""
    view = live.open_view(run_dir, quiet=as_json)
    try:
        ended = start(view.update)
    finally:
        view.close()
    return conclude(run_dir, ended, as_json=as_json)


def conclude(run_dir: Path, ended: ExitSummary, *, as_json: bool) -> int:
    """Write what the run leaves for people, print the summary; returns the exit code."""
    report, confirmed = reporting.write(run_dir)
    cases = reporting.write_test_cases(run_dir)
    with open_run(run_dir) as run:
        violations, campaign = run.violations(), run.campaign
        endings = run.endings()
        every, elapsed_s, taken = (
            run.flights(),
            run.elapsed_s(),
            causes((one.violation, one.test_case) for one in run.findings()),
        )
    flights = [row for row in every if row.purpose != SHRINK]
    aside = endings.get("quarantined", 0)
    nothing_said = bool(aside) and aside == sum(endings.values())
    code = INFRASTRUCTURE if nothing_said else int(confirmed > 0)
    if as_json:
        out.json(
            {
                "run": str(run_dir),
                "ended": ended.ended,
                "why": ended.why,
                "flights": len(flights),
                "shrink_flights": len(every) - len(flights),
                "elapsed_s": elapsed_s,
                "confirmed": confirmed,
                "distinct": len({one.fingerprint for one in violations if one.standing == "confirmed"}),
                "restarts": ended.restarts,
                "set_aside": aside,
                "causes": [cause.plain() for cause in taken],
                "violations": violations,
                "report": str(report),
                "test_cases": [str(path) for path in cases if path.suffix != ".plan"],
            }
        )
        return code
    good = [one for one in violations if one.standing == "confirmed"]
    distinct = len({one.fingerprint for one in good})
    flaky = sum(1 for one in violations if one.standing == "flaky")
    out.line()
    out.line(f"{'ended' if ended.ended else 'stopped'}: {ended.why}")
    out.line(
        f"{len(flights)} flights in {elapsed_s:.0f} s; {confirmed} violations confirmed, {distinct} distinct"
        + (f", {flaky} flaky" if flaky else "")
        + (f"; {aside} test cases set aside because we could not fly or judge them" if aside else "")
        + (f"; {len(every) - len(flights)} flights more to shrink them" if len(every) > len(flights) else "")
        + (f"; {ended.restarts} processes started again" if ended.restarts else "")
    )
    for violation in sorted(good, key=lambda one: one.robustness)[:SHOWN]:
        out.line(f"  {live.violation_line(violation)}")
    if len(good) > SHOWN:
        out.line(f"  ... and {len(good) - SHOWN} more")
    if nothing_said:
        out.line("this says nothing of the vehicle: no test case could be flown and judged; see the faults above")
    if taken:
        out.line(
            "what it takes:" if campaign.search.shrink else "what it takes, not minimised ([search] shrink = true):"
        )
    for cause in taken[:SHOWN]:
        out.line(f"  {cause.policy}, {cause.violations} of them: {cause.words}   (test case {cause.name})")
    out.line()
    out.line(f"report      {report}")
    out.line(f"recordings  {run_dir / 'recordings'}   (open in Foxglove or PlotJuggler)")
    out.line(f"test cases  {run_dir / reporting.TEST_CASES}   (competition YAML)")
    if good:
        out.line(f"prove it    saflite replay {run_dir}")
    if not ended.ended:
        out.line(f"go on       saflite resume {run_dir}")
    return code
