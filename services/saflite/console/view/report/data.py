"""What the report shows, read from a run folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.campaign.engine.exposure import ArmCounts
from saflite.console.run_data.deduplication import Cause, deduplicate
from saflite.console.run_data.embargo import Released, split
from saflite.console.run_data.in_force import InForce, in_force
from saflite.console.run_data.rows import ArtefactRow, Fallbacks, FlightRow, UsageRow
from saflite.console.run_data.run_folder import RunFolder
from saflite.console.run_data.standing import inputs_told
from saflite.console.run_data.unproven import unproven
from saflite.console.view.report import made
from saflite.console.view.report.made import Made
from saflite.contract.circumstances import Circumstances
from saflite.contract.config import Campaign
from saflite.contract.events import FaultSeen, Flown, Judged, Quarantined, ViolationFound
from saflite.contract.flight import Flight, Trace
from saflite.contract.score import UNSCORED
from saflite.contract.signals import MODES, UNNAMED_MODE
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Confirmation, Judgement, Violation, with_mode_named
from saflite.contract.work import PolicyTexts
from saflite.mutator.strategies.portfolio import NAME as PORTFOLIO
from saflite.recorder.summary import Finding, Rulings, finds_of
from saflite.scorer_pool.calibration import Calibration, Row, calibrate_all

FAULTS_SHOWN = 20


class Exhibit(NamedTuple):
    """One violation with its evidence. `trace` is None where it was not kept; `flight` is the one that shows it."""

    violation: Violation
    test_case: TestCase
    judgement: Judgement | None
    recording: str
    trace: Trace | None
    flights: tuple[FlightRow, ...]
    policy_texts: PolicyTexts | None = None
    flight: Flight | None = None
    artefacts: tuple[ArtefactRow, ...] = ()
    circumstances: Circumstances | None = None
    smallest_form: str = ""


class Progress(NamedTuple):
    """The search flight by flight, each array of shape (flights,): flights since the start, their robustness, finds."""

    flights: NDArray[np.float64]
    robustness: NDArray[np.float64]
    found: NDArray[np.float64]
    behaviours: NDArray[np.float64]


class ReportData(NamedTuple):
    """All of a campaign that the report shows."""

    campaign: Campaign
    in_force: InForce
    state: str
    elapsed_s: float
    exhibits: tuple[Exhibit, ...]
    flights: tuple[FlightRow, ...]
    progress: Progress
    calibrations: tuple[Calibration, ...]
    usage: tuple[UsageRow, ...]
    faults: tuple[str, ...]
    quarantined: tuple[Quarantined, ...]
    rulings: dict[str, Rulings]
    states: dict[str, int]
    modes_unseen: tuple[str, ...]
    finds: Counter[str]  # by fingerprint, similar ones included
    fallbacks: Fallbacks = Fallbacks()
    arms: Mapping[str, ArmCounts] = MappingProxyType({})  # of a portfolio
    withheld: int = 0  # findings of memory safety not shown
    unproven: int = 0  # violations neither confirmed nor refuted
    made: Made = Made()
    inputs: str = "inputs"  # what may be said of those behind a find
    smallest_forms: frozenset[str] = frozenset()  # test cases among the exhibits that are no finds of their own
    causes: tuple[Cause, ...] = ()  # what it takes to break each policy, over all finds, similar ones included

    def finds_shown(self, confirmation: Confirmation) -> int:
        """Return how many finds of a standing are among the exhibits."""
        shown = (one.violation for one in self.exhibits if one.violation.test_case not in self.smallest_forms)
        return sum(1 for one in shown if one.confirmation == confirmation)


def read(run: RunFolder, released: Released = ()) -> ReportData:
    """Read everything the report shows; of findings of memory safety the released ones only."""
    rulings, reached = run.coverage()
    smallest_forms = run.smallest_forms()
    flights, states = tuple(run.flights()), states_named(run.target, reached)
    by_case: dict[str, list[FlightRow]] = {}
    for row in flights:
        by_case.setdefault(row.test_case, []).append(row)
    every, hidden_too = split(run.findings(similar=True), released)
    shown, kept_back = _but_similar(every), _but_similar(hidden_too)
    hidden = {one.violation.fingerprint for one in kept_back} - {one.violation.fingerprint for one in shown}
    forms = {one.smallest_form_of: one.violation.test_case for one in shown}
    exhibits = tuple(
        exhibit(run, one, by_case.get(name, []), forms.get(name, ""))
        for one in shown
        for name in [one.violation.test_case]
    )
    now = run.standing()
    quarantined, faults = troubles(run)
    violations = run.violations()
    return ReportData(
        campaign=run.campaign,
        in_force=in_force(run),
        state=now.text,
        elapsed_s=run.elapsed_s(),
        exhibits=exhibits,
        flights=flights,
        progress=progress(run),
        calibrations=calibrations(run),
        usage=tuple(run.usage()),
        fallbacks=run.fallbacks(),
        faults=faults,
        quarantined=quarantined,
        rulings=rulings,
        states=states,
        modes_unseen=modes_unseen(run.target, states),
        arms=arms_of(run),
        finds=Counter(
            one.fingerprint
            for one in violations
            if one.confirmation in ("confirmed", "similar")
            and one.fingerprint not in hidden
            and one.test_case not in smallest_forms
        ),
        withheld=len(finds_of(kept_back)),
        unproven=len(unproven(flights, violations)),
        inputs=inputs_told(now, shrinks=run.campaign.search.shrink),
        made=made.read(run, over=now.state == "ended"),
        smallest_forms=smallest_forms,
        causes=deduplicate(((one.violation, one.test_case) for one in every), smallest_forms),
    )


def _but_similar(findings: Iterable[Finding]) -> list[Finding]:
    return [one for one in findings if one.violation.confirmation != "similar"]


def arms_of(run: RunFolder) -> dict[str, ArmCounts]:
    """Return what came of the arms of a portfolio; empty for other strategies."""
    found: dict[str, ArmCounts] = {}
    for outcome in run.outcomes() if run.campaign.strategy.name == PORTFOLIO else ():
        if arm := outcome.test_case.origin.arm:
            found.setdefault(arm, ArmCounts()).add(outcome.founded)
    return dict(sorted(found.items()))


def troubles(run: RunFolder) -> tuple[tuple[Quarantined, ...], tuple[str, ...]]:
    """Return the test cases set aside, and the last faults in words."""
    facts = [event.fact for event in run.events()]
    faults = [f"{fact.where}: {fact.message}" for fact in facts if isinstance(fact, FaultSeen)]
    return tuple(fact for fact in facts if isinstance(fact, Quarantined)), tuple(faults[-FAULTS_SHOWN:])


def states_named(target: TargetInfo, states: Mapping[str, int]) -> dict[str, int]:
    """Return states with their modes by the target's own names; the books have the common ones, or `mode NUMBER`."""
    names = {number: name for name, number in target.modes.items()}
    return {_named(state, names): count for state, count in states.items()}


def _named(state: str, names: Mapping[int, str]) -> str:
    mode, _, rest = state.removeprefix(UNNAMED_MODE).partition(" ")
    number = MODES.get(mode, int(mode) if mode.isdecimal() else -1)
    return f"{names[number]} {rest}".rstrip() if number in names else state


def modes_unseen(target: TargetInfo, states: Iterable[str]) -> tuple[str, ...]:
    """Return the modes of the target that no state seen is in."""
    seen = {state.split()[0] for state in states}
    return tuple(name for name in target.modes if name not in seen) if seen else ()


def calibrations(run: RunFolder) -> tuple[Calibration, ...]:
    """Return how the scores of each model that answered met their outcomes.

    A flight counts once for a model: one may have scored it twice, in the place of another and as one that watches.
    """
    rows: dict[tuple[str, str], Row] = {}
    for score in sorted(run.scores(), key=lambda score: score.shadow):  # what decided goes before what watched
        if score.violated is not None and score.scored_by != UNSCORED:
            chosen = score.selected_by or "score"
            row = Row(model=score.scored_by, score=score.value, violated=score.violated, chosen=chosen)
            rows.setdefault((score.scored_by, score.test_case), row)
    return calibrate_all(list(rows.values()))


def exhibit(run: RunFolder, finding: Finding, rows: list[FlightRow], smallest_form: str = "") -> Exhibit:
    """Return a finding with its evidence; `rows` are the flights of its test case."""
    violation = finding.violation
    shown = next((row for row in rows if row.shows(violation)), None)
    return Exhibit(
        with_mode_named(violation, run.target.modes),
        finding.test_case,
        finding.judgement,
        finding.recording,
        run.trace(shown.trace_digest) if shown else None,
        tuple(rows),
        run.campaign.policy_texts,
        run.flight(shown) if shown else None,
        tuple(row for row in run.artefacts(violation.test_case) if row.flight_index == violation.flight_index),
        finding.circumstances,
        smallest_form,
    )


def progress(run: RunFolder) -> Progress:
    """Return the search flight by flight."""
    flown, found, fingerprints, smallest_forms = 0, 0, set[str](), run.smallest_forms()
    rows: list[tuple[float, float, float, float]] = [(0.0, np.nan, 0.0, 0.0)]
    for event in run.events():
        fact = event.fact
        if isinstance(fact, Flown):
            flown += fact.purpose == "search"
            continue
        if isinstance(fact, ViolationFound) and fact.violation.confirmation in ("confirmed", "similar"):
            found += fact.violation.test_case not in smallest_forms
            fingerprints.add(fact.violation.fingerprint)
        elif not (isinstance(fact, Judged) and fact.flight_index == 0):
            continue
        judged = fact.robustness if isinstance(fact, Judged) else None
        robustness = np.nan if judged is None else judged
        rows.append((float(flown), robustness, float(found), float(len(fingerprints))))
    table = np.array(rows, dtype=float)
    return Progress(table[:, 0], table[:, 1], table[:, 2], table[:, 3])
