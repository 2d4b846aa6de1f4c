"""What the search flies never depends on when a smallest form was flown, even where both are the same test case."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import msgspec
import pytest
from books_drive import Driver, doubles

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.contract.score import Score
from saflite.contract.test_case import Stimulus, TestCase, identity
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import (
    FlyWork,
    JudgeResult,
    JudgeWork,
    MutateResult,
    MutateWork,
    Result,
    ScoreResult,
    ScoreWork,
    Stage,
    Work,
)

ROUND = 20  # in which the strategy proposes what is the smallest form of its first find


def _case(*names: str, rng_seed: int = 0) -> TestCase:
    stimuli = tuple(Stimulus(at_s=0.0, kind="parameter", name=name, values=(0.0,)) for name in names)
    return msgspec.structs.replace(doubles.TEMPLATE, stimuli=stimuli, rng_seed=rng_seed)


class _Service(doubles.Service):
    """`BUG` and `OTHER` alone break the rule, in two ways; `form`, if there is one, is proposed in round `ROUND`."""

    def __init__(self, store: Store, form: TestCase | None) -> None:
        super().__init__(store.blobs)
        self.form, self.told, self.searched, self.shrunk = form, -1, [], {}  # type: ignore[var-annotated]

    def cursor_of(self, stage: Stage) -> int:
        return self.told if stage == "mutate" else -1

    def do(self, work: Work) -> Result:
        match work:
            case MutateWork():
                self.told = work.cursor
                cases = [_case(f"N{work.round}", "X", rng_seed=place) for place in range(3)] if work.count else []
                first = {0: _case("BUG", "Q", "R"), 1: _case("OTHER", "S", "T"), ROUND: self.form}.get(work.round)
                return MutateResult(round=work.round, test_cases=tuple([first, *cases[1:]] if first else cases))
            case ScoreWork():
                scores = (9.0 if case.stimuli[0].name in ("BUG", "OTHER") else 5.0 for case in work.test_cases)
                return ScoreResult(
                    scores=tuple(
                        Score(test_case=identity(case), value=value, model=work.model, scored_by=work.model)
                        for case, value in zip(work.test_cases, scores, strict=True)
                    )
                )
            case JudgeWork():
                way = "".join(one.name for one in work.test_case.stimuli if one.name in ("BUG", "OTHER"))
                outcome = "violated" if way else "held"
                verdict = Verdict(
                    policy=doubles.POLICY,
                    outcome=outcome,  # type: ignore[arg-type]
                    robustness=-1.0 if way else 1.0,
                    severity="hard" if way else "none",
                    behaviour=way,
                )
                flight = work.flight
                return JudgeResult(
                    judgement=Judgement(
                        test_case=flight.test_case, flight_index=flight.flight_index, verdicts=(verdict,)
                    )
                )
            case FlyWork() if work.purpose == "search":
                self.searched.append(identity(work.test_case))
            case FlyWork() if work.purpose == "shrunk":
                self.shrunk[work.test_case.stimuli[0].name] = work.test_case
            case _:
                pass
        return super().do(work)


def _run(folder: Path, flyers: int, form: TestCase | None, record: str = "violations") -> tuple[_Service, Driver]:
    settings: dict[str, object] = {
        "record": record,
        "candidates_per_round": 3,
        "flights_per_round": 2,
        "lag": 2,
        "random_share": 0.0,
        "shrink": True,
    }
    store = Store.create(folder, doubles.campaign(48, **settings), doubles.TEMPLATE, doubles.TARGET)  # type: ignore[arg-type]
    driver = Driver(store.rebuild(), store)
    service = driver.service = _Service(store, form)
    while not driver.books.ended:
        for stage in (*get_args(Stage), *(("fly", "judge") * (flyers - 1))):
            for worker in ("a", "b"):
                driver.do(stage, worker, flyers if stage == "fly" else 9)
        driver.now += 0.5
        driver.books.tick(driver.now)
        assert driver.now < 5000.0, "the campaign does not end"
    return service, driver


@pytest.mark.parametrize("record", ["violations", "all"])
def test_what_is_flown_depends_on_the_search_alone(tmp_path: Path, record: str) -> None:
    probe, driver = _run(tmp_path / "probe", 16, None)
    assert driver.store is not None
    driver.store.close()
    form = msgspec.structs.replace(probe.shrunk["OTHER"], origin=doubles.TEMPLATE.origin)
    searched, finds = {}, {}
    for flyers in (1, 16):
        service, driver = _run(tmp_path / f"run{flyers}", flyers, form, record)
        status = driver.books.status(driver.now)
        finds[flyers] = status.violations_confirmed, status.violations_similar, status.test_cases
        searched[flyers] = service.searched
        assert driver.store is not None
        driver.store.close()
        assert audit(tmp_path / f"run{flyers}")["problems"] == [], f"{flyers} at a time"
    assert identity(form) in searched[1]
    assert all(set(one) == set(searched[1]) for one in searched.values())
    assert set(finds.values()) == {finds[1]}
    assert identity(form) in [identity(case) for case in service.shrunk.values()], "it was never flown as a form"
