"""What every strategy promises: its state depends on what it was told alone, its proposals on that and the draw.

from saflite.conformance.kit import findings
from saflite.conformance.strategies import Setup, check_strategy

assert findings(check_strategy(Setup("my-strategy", Strategy, load_target("reference").describe()))) == []
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import msgspec

from saflite.conformance.kit import Check
from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.flight import Ending
from saflite.contract.rng import derive
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Scenario, Setting, StartState, Target, TestCase, identity
from saflite.contract.work import Outcome
from saflite.flight.geometry import COMPETITION_AREA, COMPETITION_SIZES, check_layout
from saflite.flight.mission import builtin_mission
from saflite.mutator.strategy import Option, Strategy

BOXES_MAX = 4
COUNTS = (1, 7, 40)
POLICIES = {"obstacles": ("min-obstacle-distance",), "stimuli": ("a-chute",)}
UNKNOWN = "no such setting"


class Setup(NamedTuple):
    """A strategy by name and class, and what it is to search with; `policies` default to built-in ones."""

    name: str
    kind: type[Strategy]
    target: TargetInfo
    mission: str = "mission2"
    policies: tuple[str, ...] = ()

    def template(self) -> TestCase:
        """Return the test case proposals are made from: a mission for obstacles, a start state for stimuli."""
        vehicle = Target(name=self.target.name)
        if self.kind.proposes == "obstacles":
            return TestCase(target=vehicle, scenario=Scenario(mission=builtin_mission(self.mission)), rng_seed=5)
        start = self.target.start_states[0] if self.target.start_states else StartState()
        return TestCase(target=vehicle, scenario=Scenario(start=start, time_limit_s=60.0), rng_seed=5)

    def of(self, template: TestCase, settings: dict[str, Setting]) -> Strategy:
        """Return a new strategy."""
        return self.kind(template, settings, self.policies or POLICIES[self.kind.proposes], self.target)

    def new(self) -> Strategy:
        """Return a new strategy with the usual template and settings."""
        return self.of(self.template(), {})


Promise = Callable[[Setup], Iterator[str]]


def check_strategy(setup: Setup) -> tuple[Check, ...]:
    """Return the checks of a strategy; each makes strategies of its own."""
    promises: tuple[Promise, ...] = (
        its_settings_are_documented,
        unknown_settings_and_values_out_of_range_are_refused,
        a_template_it_cannot_mutate_is_refused,
        it_gives_as_many_as_asked_and_the_same_for_the_same_draw,
        its_state_depends_on_what_it_was_told_alone,
        flights_without_result_and_test_cases_of_others_do_no_harm,
        proposals_keep_the_template_and_name_their_origin,
        proposals_are_plain_numbers,
        layouts_keep_the_rules_of_the_competition,
    )
    return tuple(Check(promise.__name__, partial(promise, setup)) for promise in promises)


def outcome_of(case: TestCase, round_: int) -> Outcome:
    """Return an outcome that depends on the test case alone, as a deterministic target's would."""
    draw = float(derive(0, "outcome", identity(case)).uniform(-1.0, 6.0))
    violated = ("some-policy",) if draw < 0 else ()
    features = {"min_distance_m": draw + 1.5}
    return Outcome(
        test_case=case, round=round_, ending="completed", robustness=draw, violated=violated, features=features
    )


def rounds_of(strategy: Strategy, count: int) -> list[list[Outcome]]:
    """Return the outcomes of some rounds: ask, let every second test case fly, tell."""
    rounds = []
    for number in range(count):
        cases = [_in_round(case, number) for case in strategy.ask(20, derive(3, "mutate", number))]
        outcomes = [outcome_of(case, number) for case in cases[::2]]
        strategy.tell(outcomes)
        rounds.append(outcomes)
    return rounds


def asked(strategy: Strategy, label: int = 99) -> list[TestCase]:
    """Return fifteen proposals of a named draw."""
    return strategy.ask(15, derive(1, label))


# ---- promises -----------------------------------------------------------------------------------------------------


def its_settings_are_documented(setup: Setup) -> Iterator[str]:
    """Each setting has a meaning, and a default within its range."""
    if setup.kind.proposes not in POLICIES:
        yield f"proposes is {setup.kind.proposes!r}, expected one of {', '.join(POLICIES)}"
    for name, option in setup.kind.options.items():
        if len(option.meaning) <= 8:
            yield f"setting {name} is not explained: {option.meaning!r}"
        if _is_number(option.default) and not option.least <= option.default <= option.most:  # type: ignore[operator]
            yield f"setting {name}: default {option.default} lies outside {option.least:g} to {option.most:g}"


def unknown_settings_and_values_out_of_range_are_refused(setup: Setup) -> Iterator[str]:
    """A setting that is not known, of another type, or out of range is Refused by name."""
    wrong: list[tuple[str, Setting]] = [(UNKNOWN, 3)]
    for name, option in setup.kind.options.items():
        wrong.append((name, ["a", "list"] if not isinstance(option.default, list) else 3))
        wrong += [(name, value) for value in _beyond(option)]
    for name, value in wrong:
        try:
            setup.of(setup.template(), {name: value})
        except Refused as fault:
            if name not in str(fault):
                yield f"{name} = {value!r} is refused without naming it: {fault}"
        else:
            yield f"{name} = {value!r} is taken"


def a_template_it_cannot_mutate_is_refused(setup: Setup) -> Iterator[str]:
    """A test case with neither mission nor start state gives nothing to search in."""
    try:
        setup.of(TestCase(target=Target(name=setup.target.name), scenario=Scenario()), {})
    except Refused:
        return
    yield "a template without mission and start state is taken"


def it_gives_as_many_as_asked_and_the_same_for_the_same_draw(setup: Setup) -> Iterator[str]:
    """Proposals depend on the random stream handed in and nothing else."""
    for count in COUNTS:
        cases = setup.new().ask(count, derive(4, "ask"))
        if len(cases) != count:
            yield f"{len(cases)} proposals, {count} were asked for"
        if cases != setup.new().ask(count, derive(4, "ask")):
            yield "the same draw gives other proposals"
    if asked(setup.new(), 1) == asked(setup.new(), 2):
        yield "another draw gives the same proposals"
    different = len({identity(case) for case in setup.new().ask(40, derive(4, "ask"))})
    if different <= 30:
        yield f"only {different} of 40 proposals differ"


def its_state_depends_on_what_it_was_told_alone(setup: Setup) -> Iterator[str]:
    """Asking changes nothing; telling everything again, by rounds or at once, gives the same strategy."""
    strategy = setup.new()
    rounds = rounds_of(strategy, 6)
    expected = asked(strategy)
    for label in range(5):
        asked(strategy, label)
    if asked(strategy) != expected:
        yield "asking changed the state"
    again = setup.new()
    for outcomes in rounds:
        again.tell(outcomes)
    if asked(again) != expected:
        yield "telling everything again round by round gave another strategy"
    at_once = setup.new()
    at_once.tell([outcome for outcomes in rounds for outcome in outcomes])
    if asked(at_once) != expected:
        yield "telling everything at once gave another strategy"


def flights_without_result_and_test_cases_of_others_do_no_harm(setup: Setup) -> Iterator[str]:
    """Lost and wedged flights, and outcomes of test cases it never proposed, are taken."""
    strategy, other = setup.new(), setup.template()
    endings: tuple[Ending, ...] = ("wedged", "lost", "infra")
    strategy.tell([Outcome(test_case=other, round=0, ending=ending, robustness=None) for ending in endings])
    strategy.tell([outcome_of(other, 0)])
    if len(asked(strategy)) != 15:
        yield "it proposes less than asked for afterwards"


def proposals_keep_the_template_and_name_their_origin(setup: Setup) -> Iterator[str]:
    """Target, mission and rng_seed stay; the origin is the strategy, the parent a test case that was flown, or none."""
    base = setup.template()
    for case, known in _proposals(setup):
        kept = (case.target.name, case.scenario.mission, case.rng_seed)
        if kept != (base.target.name, base.scenario.mission, base.rng_seed):
            yield "a proposal has another target, mission or rng_seed than the template"
        if case.origin.strategy != setup.name:
            yield f"a proposal names {case.origin.strategy!r} as its strategy"
        if case.origin.parent and case.origin.parent not in known:
            yield f"a proposal names parent {case.origin.parent}, which was never flown"
        if wire.decode(wire.encode(case), TestCase) != case:
            yield "a proposal does not survive the way over the wire"


def proposals_are_plain_numbers(setup: Setup) -> Iterator[str]:
    """Numbers are finite Python floats, not scalars of a library."""
    for case, _ in _proposals(setup):
        for box in case.scenario.obstacles:
            yield from _not_plain("an obstacle", msgspec.structs.astuple(box))
        for stimulus in case.stimuli:
            yield from _not_plain(f"stimulus {stimulus.name}", (stimulus.at_s, *stimulus.values))


def layouts_keep_the_rules_of_the_competition(setup: Setup) -> Iterator[str]:
    """Obstacles lie in the area, do not overlap, and have the sizes allowed."""
    if setup.kind.proposes != "obstacles":
        return
    strategy = setup.new()
    flown = [outcome.test_case for outcomes in rounds_of(strategy, 5) for outcome in outcomes]
    for case in (*flown, *asked(strategy)):
        if not case.scenario.obstacles:
            yield "a proposal has no obstacles"
            continue
        try:
            check_layout(case.scenario.obstacles, COMPETITION_AREA, BOXES_MAX, COMPETITION_SIZES)
        except Refused as fault:
            yield str(fault)
        if not all(0 <= box.rotation_deg <= 90 for box in case.scenario.obstacles):
            yield "an obstacle is turned by less than 0 or more than 90 degrees"


def _proposals(setup: Setup) -> list[tuple[TestCase, set[str]]]:
    """Return proposals after five rounds, each with the test cases flown until then."""
    strategy = setup.new()
    known = {identity(outcome.test_case) for outcomes in rounds_of(strategy, 5) for outcome in outcomes}
    return [(case, known) for case in asked(strategy)]


def _in_round(case: TestCase, number: int) -> TestCase:
    return msgspec.structs.replace(case, origin=msgspec.structs.replace(case.origin, round=number))


def _is_number(value: Setting) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _beyond(option: Option) -> Iterator[Setting]:
    if isinstance(option.default, int | float) and not isinstance(option.default, bool) and math.isfinite(option.most):
        yield type(option.default)(option.most + 1)


def _not_plain(what: str, values: Sequence[object]) -> Iterator[str]:
    for value in values:
        if type(value) is not float or not math.isfinite(value):
            yield f"{what} holds {value!r}, expected a finite float"
