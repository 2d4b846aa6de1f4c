"""Counts a run anew from its journal, by itself: what was issued, how it ended, what was flown, what was told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from saflite.campaign.engine.journal import (
    GaveUp,
    Granted,
    Line,
    Returned,
    Selected,
    Settled,
    TraceMissing,
    decode_line,
)
from saflite.campaign.scheduling.work_keys import FlyKey, JudgeKey, ScoreKey, WarmKey, WorkKey
from saflite.contract.events import Fact, Flown, Judged, Proposed, Quarantined, Scored, ViolationFound
from saflite.contract.flight import FLOWN_ENDINGS, UNTOLD
from saflite.contract.work import FlyResult, JudgeResult, MutateResult, ScoreResult

Judging = tuple[str, int]
Flight = tuple[str, int, bool]
"""Test case, index, and whether it was flown as a smallest form."""


class JournalAudit:
    """Feed it every line of the journal in order."""

    def __init__(self) -> None:
        self.lines = 0
        self.problems: list[str] = []
        self.issued = 0
        self.untold: Counter[str] = Counter()  # flights that are not announced, by purpose
        self.ended: Counter[str] = Counter()
        self._open: dict[WorkKey, int] = {}  # work: attempt under way
        self._selected: Counter[str] = Counter()
        self._forms: set[str] = set()  # flown as smallest forms; one may have been selected, too, and end once as each
        self._flown: dict[Flight, int] = {}  # accepted results, by flight
        self._flown_anew: Counter[Flight] = Counter()  # taken, told, but its trace was lost before it was judged
        self._judged: Counter[Judging] = Counter()
        self._told_flown: Counter[Flight] = Counter()
        self._ended_cases: Counter[str] = Counter()
        self._confirmations: Counter[str] = Counter()
        self._proposed = self._scored = 0

    # ---- the journal ---------------------------------------------------------------------------------------------

    def add(self, data: bytes) -> None:
        """Count one line."""
        self.lines += 1
        line: Line = decode_line(data)
        match line.entry:
            case Granted(key=key, epoch=epoch):
                self.issued += 1
                if key in self._open:
                    self.problems.append(f"{key} was lent out as attempt {epoch} while attempt {self._open[key]} ran")
                self._open[key] = epoch
            case Returned(key=key, epoch=epoch, how=how):
                self._end(key, epoch, how)
            case Settled(key=key, epoch=epoch):
                self._settled(line.entry)
            case Selected(picks=picks):
                self._selected.update(pick.test_case for pick in picks)
            case GaveUp(key=key):
                self._open.pop(key, None)
            case TraceMissing(key=key):
                self._open.pop(key, None)
                if isinstance(key, JudgeKey) and key.purpose not in UNTOLD:
                    flight = (key.test_case, key.index, key.purpose == "shrunk")
                    self._flown[flight] -= 1
                    self._flown_anew[flight] += 1
            case _:
                pass

    def _end(self, key: WorkKey, epoch: int, how: str) -> None:
        if self._open.get(key) != epoch:
            self.problems.append(f"{key}: attempt {epoch} ended ({how}) but was not under way")
        self._open.pop(key, None)
        self.ended[how] += 1

    def _settled(self, entry: Settled) -> None:
        running = self._open.pop(entry.key, None)
        if running is not None:
            self.ended["settled" if running == entry.epoch else "overtaken"] += 1
        else:
            self.ended["settled late"] += 1
        result = entry.result
        is_form = False
        if isinstance(entry.key, FlyKey) and entry.key.purpose == "shrunk":
            is_form = True
            self._forms.add(entry.key.test_case)
        if isinstance(entry.key, FlyKey | JudgeKey) and entry.key.purpose in UNTOLD:
            self.untold[entry.key.purpose] += isinstance(result, FlyResult)
        elif isinstance(result, FlyResult) and result.flight.ending in FLOWN_ENDINGS:
            flight = (result.flight.test_case, result.flight.flight_index, is_form)
            self._flown[flight] = self._flown.get(flight, 0) + 1
        elif isinstance(result, JudgeResult):
            self._judged[result.judgement.test_case, result.judgement.flight_index] += 1
        elif isinstance(result, MutateResult):
            self._proposed += 1
        elif isinstance(result, ScoreResult):
            self._scored += 1

    # ---- what was told -------------------------------------------------------------------------------------------

    def compare_told(self, facts: Sequence[Fact]) -> list[str]:
        """Return where the facts told and the results taken differ."""
        told_judged: Counter[Judging] = Counter()
        violations: Counter[tuple[str, str]] = Counter()
        proposed = scored = 0
        for fact in facts:
            match fact:
                case Flown():
                    flight = (fact.test_case, fact.flight_index, fact.purpose == "shrunk")
                    self._told_flown[flight] += 1
                    if fact.ending in FLOWN_ENDINGS:
                        continue
                    self._flown[flight] = self._flown.get(flight) or 1  # given up, maybe after its trace was lost
                case Judged():
                    told_judged[fact.test_case, fact.flight_index] += 1
                    is_last = fact.flight_index == 0 and not fact.violated
                    if is_last and fact.test_case in self._selected:  # a smallest form may be flown on
                        self._ended_cases[fact.test_case] += 1
                case Quarantined():
                    self._ended_cases[fact.test_case] += 1
                case ViolationFound():
                    violation = fact.violation
                    violations[violation.test_case, violation.policy] += 1
                    self._confirmations[violation.confirmation] += 1
                case Proposed():
                    proposed += 1
                case Scored():
                    scored += 1
                case _:
                    pass
        self._ended_cases.update({name for name, _ in violations})
        return [
            *_unequal("flights told", self._told_flown, Counter(self._flown) + self._flown_anew),
            *_unequal("judgements told", told_judged, self._judged),
            *[
                f"{key} was announced {count} times"
                for key, count in violations.items()
                if count > 1 + (key[0] in self._forms)
            ],
            *([] if proposed == self._proposed else [f"rounds: {self._proposed} proposed, {proposed} told"]),
            *([] if scored >= self._scored else [f"batches: {self._scored} scored, {scored} told"]),
            *self._doubled(),
        ]

    def _doubled(self) -> list[str]:
        ended = self._ended_cases.items()
        return [
            *[f"flight {key} was counted {count} times" for key, count in self._flown.items() if count > 1],
            *[f"test case {name} was selected {count} times" for name, count in self._selected.items() if count > 1],
            *[f"test case {name} ended {count} times" for name, count in ended if count > 1 + (name in self._forms)],
        ]

    def left_open(self) -> list[str]:
        """Return what a campaign that is over has left open."""
        unfinished = sorted(set(self._selected) - set(self._ended_cases))
        running = sorted(str(key) for key in set(self._open) - self._let_go)
        return [
            *[f"test case {name} has not ended" for name in unfinished],
            *[f"{key} is still under way" for key in running],
        ]

    @property
    def charged(self) -> int:
        """Flights that count against the budget."""
        counted = self._counted
        return sum(1 for name, index, is_form in counted if name in self._selected and not index and not is_form)

    @property
    def _counted(self) -> list[Flight]:
        return [flight for flight, count in self._flown.items() if count > 0]

    @property
    def _let_go(self) -> set[WorkKey]:
        """Attempts of scorers: a campaign that is over waits for none."""
        return {key for key in self._open if isinstance(key, ScoreKey | WarmKey)}

    def figures(self, *, over: bool) -> dict[str, Any]:
        """Return the counts; of a campaign that is `over`, what it waits for no more has ended with it."""
        let_go = len(self._let_go) if over else 0
        left = len(self._open) - let_go
        by_end = self.ended + Counter({"with the campaign": let_go})
        return {
            "attempts_issued": self.issued,
            "attempts_ended": self.issued - left,
            "attempts_open": left,
            "attempts_by_end": dict(sorted(by_end.items())),
            "test_cases_selected": sum(self._selected.values()),
            "test_cases_ended": len(set(self._ended_cases) & set(self._selected)),
            "flights": self.charged,
            "confirm_flights": sum(1 for _, index, is_form in self._counted if index and not is_form),
            "check_flights": self.untold["check"],
            "shrink_flights": self.untold["shrink"] + sum(1 for _, _, is_form in self._counted if is_form),
            "flights_counted_twice": sum(1 for count in self._flown.values() if count > 1),
            "results_missing": sum(1 for key, count in self._flown.items() if count > 0 and not self._told_flown[key]),
            "violations": dict(sorted(self._confirmations.items())),
        }


def _unequal(what: str, told: Counter[Any], taken: Counter[Any]) -> list[str]:
    names = [key for key in {*told, *taken} if told[key] != taken[key]]
    return [f"{what}: {key} {told[key]} times, taken {taken[key]} times" for key in sorted(names)[:20]]
