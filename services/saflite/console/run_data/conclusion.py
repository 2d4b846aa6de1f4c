"""What a run came to: read from its folder once it is over, told as text or as JSON, and as an exit code."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from saflite.console.cli import FOUND, INFRASTRUCTURE, NOTHING_FOUND, NOTHING_JUDGED
from saflite.console.run_data import reporting
from saflite.console.run_data.deduplication import Cause, deduplicate
from saflite.console.run_data.embargo import withheld_words
from saflite.console.run_data.rows import Fallbacks
from saflite.console.run_data.run_folder import RunFolder, open_run
from saflite.console.run_data.standing import BY_ORDER
from saflite.console.run_data.unproven import unproven, unproven_words
from saflite.console.view import live, out
from saflite.contract.circumstances import in_words
from saflite.contract.flight import Purpose
from saflite.contract.plain import argument, counted
from saflite.contract.verdict import NEVER_APPLIED, Violation, with_mode_named, worst_first
from saflite.recorder.summary import Finding, Rulings

if TYPE_CHECKING:
    from saflite.runtime.campaign_runner import ExitSummary

SHOWN = 12
FEW = 4
LEFT = (
    ("recordings", "recordings", "open in Foxglove or PlotJuggler"),
    ("test cases", reporting.TEST_CASES, "competition YAML"),
)
"""Policies that are told of one by one; of more only those that never applied."""


class Conclusion(NamedTuple):
    """What a run came to. `set_aside` counts test cases that we could not fly or judge, of `cases` ended.

    `flown` counts flights by what they were flown for, of the search up to `budget`; `standings` finds, `unproven`
    violations that are neither confirmed nor refuted; `violations` tells of smallest forms, too. `inputs` says what may
    be said of the inputs behind the `causes`.
    """

    flown: Counter[Purpose]
    budget: int
    elapsed_s: float
    cases: int
    set_aside: int
    violations: tuple[Violation, ...]
    standings: Counter[str]
    causes: tuple[Cause, ...]
    findings: tuple[Finding, ...]
    rulings: dict[str, Rulings]
    inputs: str
    fallbacks: Fallbacks = Fallbacks()
    modes: Mapping[str, int] = MappingProxyType({})
    unproven: int = 0

    @property
    def confirmed(self) -> list[Violation]:
        """The violations that failed again, the worst first."""
        return sorted((one for one in self.violations if one.confirmation == "confirmed"), key=worst_first)

    @property
    def behaviours(self) -> list[Violation]:
        """The worst confirmed violation of each behaviour, the worst first."""
        return list({one.fingerprint: one for one in reversed(self.confirmed)}.values())[::-1]

    @property
    def exit_code(self) -> int:
        """For scripts; a run in which nothing could be judged is no success, nor is one with unproven violations."""
        if self.confirmed or self.unproven:
            return FOUND
        if self.set_aside and self.set_aside == self.cases:
            return INFRASTRUCTURE
        told = any(ruled.judged > ruled.inconclusive for ruled in self.rulings.values())
        return NOTHING_FOUND if told else NOTHING_JUDGED


def conclude(run_dir: Path, ended: ExitSummary, *, as_json: bool) -> int:
    """Write what the run leaves for people, print the summary; returns the exit code."""
    report, shown = reporting.write(run_dir)
    cases = reporting.write_test_cases(run_dir)
    with open_run(run_dir) as run:
        found = _read(run, shown.inputs)
    if as_json:
        files = {"report": str(report), "test_cases": [str(path) for path in cases if path.suffix != ".plan"]}
        asked = {one.violation.fingerprint: one.circumstances for one in reversed(found.findings)}
        out.json({"run": str(run_dir), **_plain(found, ended), "asked_first": asked, **files})
        return _code(found, ended)
    _tell(found, ended)
    out.line()
    kept = f"   ({withheld_words(shown.withheld)}; `saflite report --release`)" if shown.withheld else ""
    out.line(f"report      {report}{kept}")
    for what, name, words in LEFT:
        if (run_dir / name).is_dir():
            out.line(f"{what}  {run_dir / name}   ({words})")
    if found.confirmed:
        out.line(f"prove it    {out.program()} replay {argument(run_dir)}")
    if not ended.ended or ended.why == BY_ORDER:
        out.line(f"go on       {out.program()} resume {argument(run_dir)}")
    elif ended.failed:
        again = f"{out.program()} resume {argument(run_dir)} --budget {found.budget}"
        out.line(f"go on       {again}   (asks the strategy again; a mended one: --module FILE)")
    return _code(found, ended)


def _code(found: Conclusion, ended: ExitSummary) -> int:
    """Return the exit code; a campaign that was cut short by its closed terminal or a part that broke is no success."""
    cut = ended.why == f"signal {signal.SIGHUP.name}" and not ended.ended
    quiet = found.exit_code in {NOTHING_FOUND, NOTHING_JUDGED}
    if ended.failed:
        out.complain("unavailable", ended.why)
        return INFRASTRUCTURE if quiet else found.exit_code
    return 128 + signal.SIGHUP if cut and quiet else found.exit_code


def _read(run: RunFolder, inputs: str) -> Conclusion:
    endings, findings = run.endings(), run.findings(similar=True)
    flights, violations = run.flights(), tuple(run.violations())
    return Conclusion(
        flown=Counter(row.purpose for row in flights),
        budget=run.budget(),
        elapsed_s=run.elapsed_s(),
        cases=sum(endings.values()),
        set_aside=endings.get("quarantined", 0),
        violations=violations,
        standings=run.standings(),
        causes=deduplicate(((one.violation, one.test_case) for one in findings), run.smallest_forms()),
        findings=tuple(one for one in findings if one.violation.confirmation != "similar"),
        rulings=run.rulings(),
        inputs=inputs,
        fallbacks=run.fallbacks(),
        modes=run.target.modes,
        unproven=len(unproven(flights, violations)),
    )


def _plain(found: Conclusion, ended: ExitSummary) -> dict[str, Any]:
    return {
        "ended": ended.ended,
        "why": ended.why,
        "failed": ended.failed,
        "flights": found.flown["search"],
        "budget": found.budget,
        "confirm_flights": found.flown["confirm"],
        "check_flights": found.flown["check"],
        "shrink_flights": found.flown["shrink"] + found.flown["shrunk"],
        "elapsed_s": found.elapsed_s,
        "processor_s": None if ended.status is None else ended.status.processor_s,
        "behaviours": len(found.behaviours),
        "confirmed": found.standings["confirmed"],
        "similar": found.standings["similar"],
        "unproven": found.unproven,
        "arms": () if ended.status is None else ended.status.arms,
        "restarts": ended.restarts,
        "fallbacks": found.fallbacks.embedded,
        "unscored": found.fallbacks.unscored,
        "fallback_why": found.fallbacks.why,
        "set_aside": found.set_aside,
        "causes": [cause.plain() for cause in found.causes],
        "policies": {name: ruled._asdict() for name, ruled in found.rulings.items()},
        "violations": [with_mode_named(one, found.modes) for one in found.violations],
    }


def _tell(found: Conclusion, ended: ExitSummary) -> None:
    good, similar, flaky = found.behaviours, found.standings["similar"], found.standings["flaky"]
    out.line()
    flights = found.flown["search"]
    short = f" ({flights} of {found.budget} flights)" if flights < found.budget else ""
    out.line(f"{'ended' if ended.ended else 'stopped'}: {ended.why}{short}")
    out.line(
        f"{counted(flights, 'flight')} in {found.elapsed_s:.0f} s ({_beside(found.flown)}); "
        f"{counted(len(good), 'behaviour')} confirmed{_value(ended)}"
        + (f", {counted(len(found.causes), 'smallest set')} of inputs behind them" if found.causes else "")
        + (f", {counted(similar, 'find')} more of them" if similar else "")
        + (f", {flaky} flaky" if flaky else "")
        + (f", {unproven_words(found.unproven)}" if found.unproven else "")
        + (f"; {found.set_aside} test cases set aside, we could not fly or judge them" if found.set_aside else "")
        + (f"; {ended.restarts} processes started again" if ended.restarts else "")
    )
    if told := found.fallbacks.in_words(" of the one asked"):
        out.line(told)
    if ended.status is not None and ended.status.arms:
        out.line(f"arms: {live.arms_told(ended.status.arms)}")
    _tell_behaviours(found)
    _tell_rulings(found.rulings)
    if found.exit_code == INFRASTRUCTURE:
        out.line("this says nothing of the vehicle: no test case could be flown and judged; see the faults above")
    if found.exit_code == NOTHING_JUDGED:
        why = (
            "no rule could be judged, `saflite fly` says why"
            if _judged(found)
            else "it ended before a flight was judged"
        )
        out.line(f"this says nothing of the vehicle: {why}")
    if found.causes:
        out.line(f"what it takes ({found.inputs}):")
    for cause in found.causes[:SHOWN]:
        out.line(f"  {cause.policy}, {cause.violations} of them: {cause.words}   (test case {cause.name})")


def _tell_behaviours(found: Conclusion) -> None:
    """Show behaviours with what maintainers ask of a finding; what is so of all that are shown is said once."""
    good = found.behaviours
    known = {(one.violation.fingerprint, one.violation.test_case): one.circumstances for one in found.findings}
    forms = {one.smallest_form_of: one.violation.test_case for one in found.findings}
    shown_first = [(known.get((one.fingerprint, one.test_case)), one.test_case) for one in good[:SHOWN]]
    answers = [{} if one is None else in_words(one, forms.get(name, "")) for one, name in shown_first]
    common = set.intersection(*({*one.items()} for one in answers)) if len(answers) > 1 else set()
    for violation, answer in zip(good, answers, strict=False):
        out.line(f"  {live.violation_line(with_mode_named(violation, found.modes))}")
        own = [f"{what}: {words}" for what, words in answer.items() if (what, words) not in common]
        if own:
            out.line("    " + "; ".join(own))
    if len(good) > SHOWN:
        out.line(f"  ... and {len(good) - SHOWN} more")
    if common:
        shown = "those shown" if len(good) > SHOWN else "them"
        said = [f"{what}: {words}" for what, words in answers[0].items() if (what, words) in common]
        out.line(f"  all of {shown}: {'; '.join(said)}")


def _value(ended: ExitSummary) -> str:
    """Return in words what the processor time of this sitting was worth."""
    status = ended.status
    if status is None or status.behaviours_per_core_minute is None:
        return ""
    return f" ({status.behaviours_per_core_minute:.2f} per core-minute of {status.processor_s / 60.0:.1f})"


def _beside(flown: Counter[Purpose]) -> str:
    """Return in words the flights that do not count against the budget."""
    shrinking = flown["shrink"] + flown["shrunk"]
    words = f"and {flown['confirm']} to confirm, {flown['check']} to check the farm"
    return words + (f", {shrinking} to shrink" if shrinking else "")


def _judged(found: Conclusion) -> bool:
    return any(ruled.judged for ruled in found.rulings.values())


def _tell_rulings(rulings: dict[str, Rulings]) -> None:
    """Say which rules applied how often; of many only those that never did, for they were not put to the test."""
    if len(rulings) <= FEW:
        for name, ruled in rulings.items():
            out.line(f"policy {name}: {ruled.text()}")
        return
    silent = [name for name, ruled in rulings.items() if ruled.judged and ruled.vacuous == ruled.judged]
    out.line(f"{len(rulings) - len(silent)} of {len(rulings)} policies applied or could be judged in some flight")
    if silent:
        out.line(f"vacuous, {NEVER_APPLIED} in any flight: {', '.join(silent)}")
