"""A portfolio: who gets credit for what, which arms are refused, and the same finds whoever does the work."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import cast

import msgspec
import pytest

from saflite.campaign.engine.exposure import ArmCounts
from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.io.campaign_options import changed, check_runnable
from saflite.console.run_data.run_folder import RunFolder
from saflite.console.view.live import arms_told
from saflite.console.view.report.data import arms_of
from saflite.console.view.report.page import arms
from saflite.contract.config import StrategyConfig
from saflite.contract.control import ArmStanding
from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Setting, TestCase, identity
from saflite.contract.verdict import Transition
from saflite.contract.work import MutateResult, Outcome, Stage
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.strategies.portfolio import Strategy
from saflite.mutator.work import Mutator, open_service

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, MemoryStore, doubles

CAMPAIGN = load_campaign("avoidance-m2")
TEMPLATE = template(CAMPAIGN)
TARGET = msgspec.structs.replace(describe(), build="")
TWO: list[str | float | bool | int] = ["random_boxes", "near_miss"]


def made(**settings: Setting) -> Strategy:
    return Strategy(TEMPLATE, settings, CAMPAIGN.policies, describe())


def shares(strategy: Strategy, count: int = 400) -> Counter[str]:
    return Counter(case.origin.arm for case in strategy.ask(count, derive(1, "ask")))


def told(case: TestCase, **changes: object) -> Outcome:
    features = {"duration_s": 100.0}
    whole = {"test_case": case, "round": 0, "ending": "completed", "robustness": 2.0, "features": features, **changes}
    return Outcome(**whole)  # type: ignore[arg-type]


def taught(strategy: Strategy, changes: dict[str, dict[str, object]]) -> Strategy:
    """Tell of 60 flights, those of an arm changed as said."""
    cases = strategy.ask(60, derive(2, "teach"))
    strategy.tell([told(case, **changes.get(case.origin.arm, {})) for case in cases])
    return strategy


# ---- who gets credit -----------------------------------------------------------------------------------------------


def test_an_arm_whose_flights_show_new_behaviours_proposes_more() -> None:
    found = shares(taught(made(arms=TWO), {"near_miss": {"founded": 1}}))
    assert found["near_miss"] > 10 * found["random_boxes"]


def test_a_behaviour_that_was_known_is_worth_nothing() -> None:
    found = shares(taught(made(arms=TWO), {"near_miss": {"violated": CAMPAIGN.policies, "behaviours": ("0" * 16,)}}))
    assert found["near_miss"] < 3 * found["random_boxes"]


def test_of_arms_that_find_alike_the_one_with_shorter_flights_proposes_more() -> None:
    long, short = {"founded": 1, "features": {"duration_s": 500.0}}, {"founded": 1, "features": {"duration_s": 20.0}}
    found = shares(taught(made(arms=TWO, overhead_s=0.0), {"random_boxes": long, "near_miss": short}))
    assert found["near_miss"] > 10 * found["random_boxes"]
    even = shares(taught(made(arms=TWO, overhead_s=10_000.0), {"random_boxes": long, "near_miss": short}))
    assert even["near_miss"] < 3 * even["random_boxes"]


def test_only_the_first_that_reaches_a_state_is_credited() -> None:
    strategy = made(arms=TWO, state=1.0)
    first, *_, last = strategy.ask(60, derive(2, "teach"))
    assert first.origin.arm != last.origin.arm
    steps = tuple(Transition(f"state {number}", f"state {number + 1}", -1, -1) for number in range(9))
    strategy.tell([told(first, transitions=steps), *[told(last, transitions=steps)] * 9])
    found = shares(strategy)
    assert found[first.origin.arm] > 10 * found[last.origin.arm]


def test_a_flight_that_said_nothing_costs_as_long_as_it_may_take() -> None:
    nothing: dict[str, object] = {"ending": "wedged", "robustness": None, "features": {}, "founded": 0}
    found = shares(taught(made(arms=TWO), {"random_boxes": nothing, "near_miss": {"founded": 1}}))
    assert found["near_miss"] > 10 * found["random_boxes"]


def test_every_arm_learns_from_the_flights_of_all() -> None:
    strategy = made(arms=["random_boxes", "near_miss:population=5,fresh=0"])
    cases = strategy.ask(40, derive(2, "teach"))
    others = [case for case in cases if case.origin.arm == "random_boxes"]
    strategy.tell([told(case, robustness=0.1) for case in others])
    children = [case for case in strategy.ask(40, derive(3, "ask")) if case.origin.arm != "random_boxes"]
    assert children
    assert {case.origin.parent for case in children} <= {identity(case) for case in others}


# ---- which arms ----------------------------------------------------------------------------------------------------


def test_unless_arms_are_named_all_that_ship_and_can_search_here_are() -> None:
    assert set(shares(made())) == {"random_boxes", "near_miss", "deephyperion", "camba", "tumb"}
    chute = load_campaign("policy-a-chute")
    strategy = Strategy(template(chute), {}, chute.policies, describe())
    assert set(shares(strategy)) == {"exposure", "pgfuzz"}, "the reference takes no messages"


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"arms": ["near_mis"]}, "did you mean near_miss?"),
        ({"arms": ["portfolio"]}, "no portfolio itself"),
        ({"arms": ["portfolio:arms=['camba']"]}, "no portfolio itself"),
        ({"arms": ["camba", "camba"]}, "each arm once"),
        ({"arms": ["camba", "messages"]}, "arm messages .*expected a campaign with a start state"),
        ({"arms": ["near_miss:frsh=0.5"]}, "arm near_miss .*did you mean fresh?"),
        ({"arms": ["near_miss:fresh=2"]}, "arm near_miss .*fresh: expected 0 to 1, got 2"),
        ({"arms": ["near_miss:fresh"]}, "arm near_miss: expected NAME=VALUE, got fresh"),
        ({"arms": [f"near_miss:fresh={'1' * 2000}"]}, "at most 1024 characters"),
        ({"arms": ["camba"], "given": ["gates=0.5"]}, "strategy setting given: expected one of .* got 'gates'"),
        ({"given": ["gates"]}, "strategy setting given: expected NAME=VALUE"),
    ],
)
def test_bad_arms_are_refused_in_one_line(settings: dict[str, Setting], said: str) -> None:
    with pytest.raises(Refused, match=said.replace("?", r"\?")) as fault:
        made(**settings)
    assert "\n" not in str(fault.value)


def test_where_no_strategy_can_search_that_is_said() -> None:
    bare = msgspec.structs.replace(describe(), inputs=())
    chute = load_campaign("policy-a-chute")
    with pytest.raises(Refused, match="a target with inputs to give"):
        Strategy(template(chute), {}, chute.policies, bare)


def test_settings_for_all_reach_the_arms_that_have_them_and_an_arms_own_come_first() -> None:
    layouts = {"boxes_min": 4, "boxes_max": 4, "gates": 0.0}
    strategy = made(
        arms=["random_boxes", "random_boxes:boxes_max=1,boxes_min=1"], given=[f"{k}={v}" for k, v in layouts.items()]
    )
    counts = {
        (case.origin.arm.partition(":")[0] == case.origin.arm, len(case.scenario.obstacles))
        for case in strategy.ask(40, derive(1, "ask"))
    }
    assert (False, 1) in counts
    assert (False, 4) not in counts
    assert (True, 1) not in counts


@pytest.mark.parametrize("name", ["policy-a-chute", "policy-a-auto1"])
def test_a_campaign_put_on_a_portfolio_hands_its_settings_to_its_own_strategy(name: str) -> None:
    base = load_campaign(name)
    campaign = changed(base, strategy="portfolio", settings=["memory=50"])
    check_runnable(campaign)
    assert campaign.strategy.settings["memory"] == 50
    handed = campaign.strategy.settings["given"]
    assert isinstance(handed, list)
    assert [str(text).partition("=")[0] for text in handed] == list(base.strategy.settings)
    settings = campaign.strategy.settings
    assert set(shares(Strategy(template(campaign), settings, campaign.policies, describe()))) == {"exposure", "pgfuzz"}
    without = changed(base, strategy="portfolio", settings=['arms=["pgfuzz"]'])
    assert "given" not in without.strategy.settings


# ---- in a campaign ---------------------------------------------------------------------------------------------------


class Farm(Driver):
    """Books, the real mutator (one for each worker) with a portfolio, all else as in the simulated farm."""

    def __init__(self, run_dir: Path | None = None, budget: int = 48) -> None:
        strategy = StrategyConfig(name="portfolio", settings={"memory": 20.0})
        made_of = (msgspec.structs.replace(doubles.campaign(budget), strategy=strategy), TEMPLATE, TARGET)
        store = cast(Store, MemoryStore(*made_of)) if run_dir is None else Store.create(run_dir, *made_of)
        super().__init__(store.rebuild(), store)
        self.mutators: dict[str, Mutator] = {}
        self.forgetful = False

    def do(self, stage: Stage, worker: str = "a", many: int = 1) -> int:
        if stage != "mutate":
            return super().do(stage, worker, many)
        if self.forgetful:
            self.mutators.pop(worker, None)
        mutator = self.mutators.setdefault(worker, open_service())
        leases = self.ask(stage, worker, 1, mutator.cursor)
        for lease in leases:
            result = mutator.do(lease.work, lambda: False)
            assert isinstance(result, MutateResult)
            assert self.report(lease, result, worker).status == "accepted"
        return len(leases)


def outcome_of_farm(workers: tuple[str, ...], *, forgetful: bool = False) -> tuple[object, ...]:
    farm = Farm()
    farm.forgetful = forgetful
    farm.run(workers)
    status = farm.books.status(farm.now)
    again = cast(MemoryStore, farm.store).empty_books()
    again.restore(farm.books.snapshot())
    assert again.status(farm.now).arms == status.arms, "a snapshot keeps what arms had"
    return status.arms, status.behaviours, status.violations_confirmed, frozenset(farm.books._core.flown.items())


def test_any_number_of_workers_and_mutators_that_die_find_the_same() -> None:
    standing, behaviours, *_ = expected = outcome_of_farm(("a", "b"))
    assert behaviours
    arms = cast(tuple[ArmStanding, ...], standing)
    assert len(arms) > 3
    assert sum(one.flights for one in arms) == 48
    assert outcome_of_farm(("a",)) == expected
    assert outcome_of_farm(("a", "b", "c")) == expected
    assert outcome_of_farm(("a", "b"), forgetful=True) == expected


def test_the_report_and_books_opened_again_tell_of_arms_what_the_screen_did(tmp_path: Path) -> None:
    farm = Farm(tmp_path / "run", 18)
    farm.run()
    shown = farm.books.status(farm.now).arms
    assert shown
    assert farm.store is not None
    farm.store.close()
    with RunFolder(tmp_path / "run") as run:
        reported = arms_of(run)
    assert [(one.arm, one.flights, one.founded) for one in shown] == [
        (arm, counts.flights, counts.founded) for arm, counts in reported.items()
    ]
    store = Store.open(tmp_path / "run")
    assert store.rebuild().status(farm.now).arms == shown
    store.close()


def test_arms_are_told_in_words_and_in_the_report() -> None:
    standing = (ArmStanding(arm="camba", flights=3, founded=2), ArmStanding(arm="tumb", flights=1, founded=0))
    assert arms_told(standing) == "camba 75% of flights, 2 behaviours, tumb 25% of flights, 0 behaviours"
    section = arms({"camba": ArmCounts(3, 2), "tumb": ArmCounts(1, 0)})
    assert "<td>camba</td><td>3</td><td>75%</td><td>2</td>" in section
    assert arms({}) == ""
