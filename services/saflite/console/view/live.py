"""What a running campaign shows: a live screen on a terminal, plain lines elsewhere, each violation as it comes."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from saflite.console.run_data.rows import Fallbacks
from saflite.console.run_data.run_folder import RunFolder, open_run
from saflite.console.view import out
from saflite.contract.config import environment
from saflite.contract.control import ArmStanding, Exposed, Status
from saflite.contract.events import FaultSeen, Quarantined, ScorerChanged, ViolationFound
from saflite.contract.plain import counted, word
from saflite.contract.verdict import Violation, failed_again, with_mode_named

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live
    from rich.table import Table
    from rich.text import Text

PLAIN_EVERY_S = 5.0
SILENT_SHOWN = 4


class View(Protocol):
    """Somebody to tell how the campaign goes."""

    def update(self, status: Status) -> None:
        """Show the state of the campaign; called about twice a second."""
        ...

    def close(self) -> None:
        """Show what came last and leave the terminal as it was."""
        ...


def open_view(run_dir: Path, quiet: bool) -> View:
    """Return what fits the output: nothing for `quiet`, a live screen for a terminal, lines for a file or pipe."""
    if quiet:
        return _Quiet()
    return _Screen(run_dir) if sys.stdout.isatty() else _Lines(run_dir)


class _Quiet:
    def update(self, status: Status) -> None:
        """Show nothing."""

    def close(self) -> None:
        """Nothing was opened."""


class News:
    """The facts worth a line of their own, each shown once; `so_far` is what was found before, empty of a new run."""

    def __init__(self, run_dir: Path) -> None:
        self._run_dir = run_dir
        self._run: RunFolder | None = None
        with open_run(run_dir) as run:
            last, found = run.last_events(1), run.standings()["confirmed"]
        self._next_seq = last[0].seq + 1 if last else 1
        self.so_far = f"so far: {found} {'violation' if found == 1 else 'violations'} confirmed" if last else ""

    def lines(self, upto_seq: int) -> list[str]:
        """Return a line for every violation and trouble committed since the last call."""
        if upto_seq < self._next_seq:
            return []
        self._run = self._run or open_run(self._run_dir)
        found = []
        for event in self._run.events(self._next_seq):
            self._next_seq = event.seq + 1
            text = fact_text(event.fact, self._run.target.modes)
            if text:
                found.append(text)
        return found

    def close(self) -> None:
        """Let go of the run folder."""
        if self._run is not None:
            self._run.close()


def fact_text(fact: object, modes: Mapping[str, int] | None = None) -> str:
    """Return the line for a fact worth one, empty for the others; `modes` are those of the target, if it is known."""
    return word(_fact_text(fact, modes or {}))


def _fact_text(fact: object, modes: Mapping[str, int]) -> str:
    if isinstance(fact, ViolationFound):
        told = with_mode_named(fact.violation, modes)
        return "" if told.confirmation == "similar" else violation_line(told)  # the 28th of a behaviour is no news
    if isinstance(fact, Quarantined):
        return f"quarantined  {fact.test_case} after {fact.attempts} attempts, last {fact.last} {fact.message}".rstrip()
    if isinstance(fact, ScorerChanged):
        change = fact.model if fact.ready else f"{fact.model} is not ready, {fact.previous} stays"
        return f"scorer  {change} {fact.message}".rstrip()
    if isinstance(fact, FaultSeen):
        return f"fault  {fact.where}: {fact.message}"
    return ""


def violation_line(violation: Violation) -> str:
    """Return a violation in one line."""
    word = "VIOLATION" if violation.confirmation == "confirmed" else violation.confirmation
    again = f"violates again {failed_again(violation)}"
    if violation.confirmation == "similar":
        again = f"as test case {violation.representative}, not flown again"
    way = violation.behaviour.removeprefix(f"{violation.policy}, {violation.severity}, ")
    return (
        f"{word}  {violation.fingerprint}  {violation.policy} {violation.robustness:+.3f} ({violation.severity})"
        f"  {way}  {again}  test case {violation.test_case}"
    )


def one_line(status: Status) -> str:
    """Return the state of the campaign in one line."""
    last = f", last {status.since_last_find_s:.0f} s ago" if status.since_last_find_s is not None else ""
    queues = " ".join(one for name, count in status.queues.items() if count for one in _waiting(status, name))
    busy = sum(1 for worker in status.workers if worker.state == "busy")
    instead = f"  {_instead(status)}" if status.fallbacks else ""
    share = f"  {shared}" if (shared := decided_share(status)) else ""
    arms = f"  arms: {arms_told(status.arms)}" if status.arms else ""
    trouble = f"  nothing goes on: {status.trouble}" if status.trouble else ""
    return (
        f"{status.elapsed_s:6.1f} s  {status.flights}/{status.budget} flights  {_phase(status)}"
        f"  {status.flights_per_s:.2f}/s"
        f"  {status.real_time_factor:.0f}x real time  {counted(status.behaviours, 'behaviour')},"
        f" {counted(_finds(status), 'find')}{_value(status)}{last}"
        f"  rules {status.exposure.spoke}/{status.exposure.spoke + len(status.exposure.silent)}"
        f"  states {status.exposure.states}  workers {busy}/{len(status.workers)} busy"
        + (f"  waiting: {queues}" if queues else "")
        + share
        + arms
        + instead
        + trouble
    )


def _waiting(status: Status, stage: str) -> list[str]:
    """Return how much waits at a stage, and whether nobody is there for it."""
    count = status.queues[stage]
    nobody = count and not any(worker.stage == stage for worker in status.workers)
    return [f"{stage} {count}", *(["(no worker for it)"] if nobody else [])]


def decided_share(status: Status) -> str:
    """Return what share of the scores asked of it the scorer decided, empty where that is all, or none were asked."""
    if status.scores_by_model >= status.scores:
        return ""
    return f"{status.scorer} decided {status.scores_by_model / status.scores:.0%} of {status.scores} scores"


def arms_told(arms: Sequence[ArmStanding]) -> str:
    """Return in words what share of the flights each arm of a portfolio had, and what came of them."""
    flights = max(1, sum(one.flights for one in arms))
    return ", ".join(f"{one.arm} {one.flights / flights:.0%} of flights, {one.founded} behaviours" for one in arms)


def _phase(status: Status) -> str:
    """Return in words what goes on: how long the budget lasts, or what is done beside it."""
    if status.state != "running":
        return status.state.upper() if status.state == "paused" else status.state
    left = status.budget - status.flights
    if left <= 0:
        if status.violations_pending:
            return "budget flown, confirming"
        return "budget flown, minimising" if status.shrink_flights else "budget flown, the last flights"
    if not status.flights_per_s:
        return "no flight yet" if not status.flights else "no flight in the last minute"
    beside = status.reflown + status.checked + status.shrink_flights  # they take turns with first flights
    left_s = left * (1.0 + beside / max(1, status.flights)) / status.flights_per_s
    return f"about {left_s:.0f} s left" if left_s < 120 else f"about {left_s / 60:.0f} min left"


def _instead(status: Status) -> str:
    """Return in words how often the scorer asked gave no score, and why."""
    return Fallbacks(status.fallbacks - status.unscored, status.unscored, status.fallback_why).in_words()


def _finds(status: Status) -> int:
    """Return how many test cases were found that violate in a way that was confirmed."""
    return status.violations_confirmed + status.violations_similar


def _value(status: Status) -> str:
    """Return in words what the processor time was worth."""
    rate = status.behaviours_per_core_minute
    return "" if rate is None else f", {rate:.2f} behaviours per core-minute"


def _beside(status: Status) -> str:
    """Return in words the flights that do not count against the budget."""
    unequal = f" ({status.unequal} differ)" if status.unequal else ""
    parts = (f"{status.reflown} to confirm", f"{status.checked} to check the farm{unequal}")
    return ", ".join((*parts, f"{status.shrink_flights} to shrink") if status.shrink_flights else parts)


def exposed(exposure: Exposed) -> tuple[str, str]:
    """Return in words which rules were put to the test, and how much of the target was seen."""
    rules = exposure.spoke + len(exposure.silent)
    few = ", ".join(exposure.silent[:SILENT_SHOWN]) + (" ..." if len(exposure.silent) > SILENT_SHOWN else "")
    never = f"; never: {few}" if exposure.silent else ""
    return (
        f"{exposure.spoke} of {rules} rules applied, in {exposure.applied_share:.0%} of verdicts{never}",
        f"{exposure.states} states, {exposure.steps} steps",
    )


class _Lines:
    """Plain lines: what is found at once, how it goes every few seconds."""

    def __init__(self, run_dir: Path) -> None:
        self._news, self._next_s = News(run_dir), 0.0
        self._last: Status | None = None
        if self._news.so_far:
            out.line(self._news.so_far)

    def update(self, status: Status) -> None:
        """Write what is new."""
        for text in self._news.lines(status.seq):
            out.line(text)
        is_new = status.trouble and not (self._last and self._last.trouble)
        begun_anew = self._last is not None and status.elapsed_s < self._last.elapsed_s  # the books were
        if status.elapsed_s >= self._next_s or begun_anew or is_new:
            out.line(one_line(status))
            self._next_s = status.elapsed_s + PLAIN_EVERY_S
        self._last = status
        out.flush()

    def close(self) -> None:
        """Write what came after the last status."""
        if self._last is not None:
            for text in self._news.lines(2**62):
                out.line(text)
        self._news.close()


def console() -> Console:
    """Return the terminal; with NO_COLOR set (no-color.org) nothing on it is coloured, dimmed or bold."""
    from rich.console import Console

    return Console(color_system=None) if environment("NO_COLOR") else Console()


class _Screen:
    """A screen that redraws itself, with the finds scrolling above it."""

    def __init__(self, run_dir: Path) -> None:
        self._news = News(run_dir)
        self._live: Live | None = None
        if self._news.so_far:
            out.line(self._news.so_far)

    def update(self, status: Status) -> None:
        """Redraw."""
        from rich.live import Live

        if self._live is None:
            self._live = Live(console=console(), auto_refresh=False, transient=True)
            self._live.start()
        for text in self._news.lines(status.seq):
            self._live.console.print(_styled(text), highlight=False)
        self._live.update(_drawn(status), refresh=True)

    def close(self) -> None:
        """Clear the screen part and print what came last."""
        if self._live is not None:
            self._live.stop()
            for text in self._news.lines(2**62):
                self._live.console.print(_styled(text), highlight=False)
        self._news.close()


def _styled(text: str) -> Text:
    return _words((text, "bold red" if text.startswith("VIOLATION") else "yellow" if _is_trouble(text) else ""))


def _is_trouble(text: str) -> bool:
    return text.startswith(("fault", "quar"))


def _words(*parts: str | tuple[str, str]) -> Text:
    """Return texts, or pairs of text and style, for the screen: no control or markup of whoever said them counts."""
    from rich.text import Text

    pairs = ((part, "") if isinstance(part, str) else part for part in parts)
    return Text.assemble(*((word(text), style) for text, style in pairs))


def _drawn(status: Status) -> RenderableType:
    from rich.console import Group
    from rich.panel import Panel
    from rich.progress_bar import ProgressBar

    bar = ProgressBar(total=max(1, status.budget), completed=status.flights, width=None)
    title = _words(
        (status.campaign, "bold"),
        f"  {status.flights}/{status.budget} flights  ",
        (f"{status.behaviours} violations", "bold red"),
        "  ",
        (_phase(status), "yellow" if status.state == "paused" else ""),
        f"  {status.elapsed_s:.0f} s",
    )
    shown = Group(bar, _facts(status), _workers(status))
    return Panel(shown, title=title, title_align="left", border_style="blue")


def _facts(status: Status) -> Table:
    from rich.table import Table

    facts = Table.grid(padding=(0, 3))
    last = "none yet" if status.since_last_find_s is None else f"{status.since_last_find_s:.0f} s ago"
    pending = f" (warming {status.scorer_pending})" if status.scorer_pending else ""
    facts.add_row(
        _words((f"{status.flights}", "bold"), f" of {status.budget} flights, beside them {_beside(status)}"),
        _words(
            (f"{status.behaviours}", "bold red"),
            f" behaviours in {_finds(status)} finds, {status.violations_flaky} flaky, "
            f"{status.violations_pending} being confirmed",
        ),
    )
    facts.add_row(
        _words(
            (f"{status.flights_per_s:.2f}", "bold"),
            " flights/s, ",
            (f"{status.real_time_factor:.0f}x", "bold"),
            " real time",
        ),
        _words(f"last find {last}{_value(status)}"),
    )
    queues = ", ".join(" ".join(_waiting(status, name)) for name in status.queues)
    facts.add_row(_words(f"round {status.round}, scorer {status.scorer}{pending}"), _words(f"waiting: {queues}"))
    if status.trouble:
        facts.add_row(_words(("nothing goes on", "bold red")), _words((status.trouble, "red")))
    if status.quarantined or status.fallbacks:
        facts.add_row(_words(f"{status.quarantined} quarantined"), _words((_instead(status), "yellow")))
    if shared := decided_share(status):
        facts.add_row("", _words(shared))
    facts.add_row(*map(_words, exposed(status.exposure)))
    if status.arms:
        facts.add_row("arms", _words(arms_told(status.arms)))
    return facts


def _workers(status: Status) -> Table:
    from rich.table import Table

    workers = Table(box=None, padding=(0, 2), header_style="dim")
    several = len({worker.host for worker in status.workers}) > 1
    for head in ("worker", *(("host",) if several else ()), "state", "done", "busy", "memory", "silent"):
        workers.add_column(head, justify="left" if head in ("worker", "host", "state") else "right")
    for worker in status.workers:
        colour = {"busy": "green", "idle": "dim"}.get(worker.state, "yellow")
        workers.add_row(
            _words(worker.worker),
            *((_words(worker.host),) if several else ()),
            _words((worker.state, colour)),
            str(worker.done),
            f"{100 * worker.busy_share:.0f} %",
            f"{worker.resident_mib:.0f} MiB",
            f"{worker.silent_s:.1f} s",
        )
    return workers
