"""A campaign file: what flies, which policies, how the search is run. Unknown keys are refused.

The only place that reads the environment (`environment`), and that says how a Python of ours is started (`own_python`).
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec

from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.gaps import told
from saflite.contract.outside import check_plain, parse_toml
from saflite.contract.test_case import Setting, StartState, Target, Wind
from saflite.contract.work import PolicyTexts, Stage


class StrategyConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which strategy proposes test cases, and its settings (listed by `saflite list strategies`)."""

    name: str = "random_boxes"
    settings: dict[str, Setting] = {}


class ScorerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which model scores. `shadow` models score the same batches without deciding.

    `guests` are names of score workers that may run other software than the books, `*` standing for any text: scores
    only change the order in which things are flown.

    `cascade`: a model that waits for a server is asked only for what it answers while simulators have work, first for
    what the embedded scorer puts first; the embedded scorer decides the rest. Without it flights wait for the model.
    """

    model: str = "blend"
    shadow: tuple[str, ...] = ()
    guests: tuple[str, ...] = ()
    batch: int = 10
    cascade: bool = True
    deadline_s: float = 60.0
    load_deadline_s: float = 300.0


class SearchConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The rhythm of the search.

    Round r draws on the outcomes of rounds up to r - lag only, so `lag` rounds can be scored, flown and judged at
    once and the campaign still is reproducible at any number of workers.

    A violation is confirmed when `confirm_needed` of `confirm_flights` re-flights, each under noise of its own, violate
    again; no more are flown than it takes to decide. Not given: 2 of 3 on a target that repeats bit by bit, 3 of 5 on
    others. On the former a re-flight ends half a minute after the moment that decided the first flight, after its
    end where that was hard. `shrink_flights_max` bounds the flights spent on making one violation smaller (60 by
    one flight each, if not given; half of it where another behaviour of the policy was found before). On a target
    that says it repeats bit by bit, about a share `check_share` of the first flights is flown over again and
    compared, and the first confirmed find of each policy. Of all these only first flights count against the budget.
    """

    candidates_per_round: int = 40
    flights_per_round: int = 8
    lag: int = 3
    random_share: float = 0.125
    novelty_weight: float = 0.5
    confirm_flights: int | None = None
    confirm_needed: int | None = None
    shrink: bool = False
    shrink_flights_max: int | None = None
    check_share: float = 0.04


class LeaseConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How long work is lent out and how often it may be lost before the test case is set aside.

    Workers send a heartbeat every `heartbeat_s`, more often where a lease needs it (five in its time), less often in
    a crowd.
    """

    lease_s: float = 10.0
    heartbeat_s: float = 3.0
    attempts_max: int = 3
    wall_limit_s: float = 120.0


class Needs(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a worker must have to be let in: cores, GPUs, and labels (`worker --label`), `*` standing for any text."""

    cores: int = 0
    gpus: int = 0
    labels: dict[str, str] = {}


class Campaign(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One campaign. `mission` names a built-in mission or a `.plan` file; without it flights begin in `start`.

    `policies` are names; in a campaign file also policy files, whose text then travels with the campaign as
    `policy_texts`, so that workers anywhere and later runs judge by the same rule.
    """

    name: str
    description: str = ""
    target: Target = Target()
    mission: str = ""
    start: StartState | None = None
    wind: Wind = Wind()
    time_limit_s: float = 500.0
    policies: tuple[str, ...] = ("min-obstacle-distance",)
    policy_texts: PolicyTexts = {}
    budget_flights: int = 100  # first flights, one for each test case
    rng_seed: int = 1
    strategy: StrategyConfig = StrategyConfig()
    scorer: ScorerConfig = ScorerConfig()
    search: SearchConfig = SearchConfig()
    lease: LeaseConfig = LeaseConfig()
    record: Literal["violations", "all", "none"] = "violations"
    keep_mb: int = 2000  # of traces, artefacts and recordings; beyond it finds leave their digests only
    needs: dict[Stage, Needs] = {}  # of the workers of a stage


def parse_campaign(text: str, where: str) -> Campaign:
    """Return the campaign in TOML `text`; raises Refused naming `where`, the key and what was expected."""
    data = parse_toml(text, "campaign file", where)
    try:
        campaign = wire.convert(data, Campaign, strict=False)
    except msgspec.ValidationError as fault:
        got = told(fault, data, Campaign)
        raise Refused("campaign file", where=where, expected="a valid campaign", got=got) from fault
    for table, part in (("target", Target), ("start", StartState), ("wind", Wind)):  # messages, too: lenient there
        for key in data.get(table, {}):
            if part is Target and key == "defects":
                fix = "planted defects are a setting of the target: [target.settings] defects = [...]"
                raise Refused("campaign file, [target]", where=where, expected="`settings`", got="'defects'", fix=fix)
            if key not in part.__struct_fields__:
                expected = f"one of {', '.join(part.__struct_fields__)}"
                raise Refused(f"campaign file, [{table}]", where=where, expected=expected, got=repr(key))
    check_campaign(campaign, where)
    return campaign


RANGES: dict[str, tuple[float, float]] = {
    "budget_flights": (1, 10**8),
    "rng_seed": (0, 2**63 - 1),
    "keep_mb": (1, 10**8),
    "time_limit_s": (0.1, 86_400),
    "wind.mean_mps": (0, 100),
    "wind.gust_mps": (0, 100),
    "wind.gust_period_s": (0.01, 3_600),
    "search.candidates_per_round": (1, 10_000),
    "search.flights_per_round": (1, 10_000),
    "search.lag": (1, 100),
    "search.random_share": (0, 1),
    "search.novelty_weight": (0, 1_000),
    "search.confirm_flights": (0, 1_000),
    "search.confirm_needed": (1, 1_000),
    "search.shrink_flights_max": (0, 100_000),
    "search.check_share": (0, 1),
    "scorer.batch": (1, 1_000),
    "scorer.deadline_s": (0.01, 86_400),
    "scorer.load_deadline_s": (0.01, 86_400),
    "lease.lease_s": (0.1, 86_400),
    "lease.heartbeat_s": (0.1, 60),
    "lease.attempts_max": (1, 1_000),
    "lease.wall_limit_s": (0.1, 86_400),
}
"""What each number of a campaign may be; one that may be left out is checked where it is given."""


def check_campaign(campaign: Campaign, where: str) -> None:
    """Raise Refused where something makes no sense: negative budget, share outside 0..1, no number, a name twice."""
    for key, (low, high) in RANGES.items():
        value: Any = campaign
        for part in key.split("."):
            value = getattr(value, part)
        if value is not None and not low <= value <= high:
            raise Refused(key, where=where, expected=f"{low:g} to {high:g}", got=value)
    search = campaign.search
    if not _may_be_needed(search):
        expected = f"1 up to search.confirm_flights ({search.confirm_flights})"
        raise Refused("search.confirm_needed", where=where, expected=expected, got=search.confirm_needed)
    if not campaign.policies:
        raise Refused("policies", where=where, expected="at least one policy", got=campaign.policies)
    for name, words in _lists(campaign):
        twice = next((word for word, count in Counter(words).items() if count > 1), "")
        if twice:
            raise Refused(name, where=where, expected="each once", got=f"{twice!r} twice")
    check_plain(msgspec.to_builtins(campaign), "campaign", where)


def _lists(campaign: Campaign) -> Iterator[tuple[str, list[str]]]:
    """Yield the lists of a campaign in which nothing may stand twice, the words of each; numbers may."""
    yield "policies", list(campaign.policies)
    yield "scorer.shadow", list(campaign.scorer.shadow)
    yield "scorer.guests", list(campaign.scorer.guests)
    for part, settings in (("strategy", campaign.strategy.settings), ("target", campaign.target.settings)):
        for name, value in settings.items():
            if isinstance(value, list):
                yield f"{part}.settings.{name}", [word for word in value if isinstance(word, str)]


def _may_be_needed(search: SearchConfig) -> bool:
    flights, needed = search.confirm_flights, search.confirm_needed
    return needed is None or (needed >= 1 and (not flights or needed <= flights))


_SANITIZERS = ("ASAN_OPTIONS", "LSAN_OPTIONS", "MSAN_OPTIONS", "TSAN_OPTIONS", "UBSAN_OPTIONS")
OF_PROGRAMS = ("PATH", "HOME", "TMPDIR", "LANG", "LC_ALL", "TZ", "LD_LIBRARY_PATH", *_SANITIZERS)


def environment_with(**variables: str) -> dict[str, str]:
    """Return the environment for another process, with some variables set."""
    return {**os.environ, **variables}


def environment_of_program(**variables: str) -> dict[str, str]:
    """Return the environment for a program of others, with some variables set: of ours what programs need to run.

    Whatever else stands there, as keys of servers, is none of theirs: they print it, or leave it in a core.
    """
    return {name: os.environ[name] for name in OF_PROGRAMS if name in os.environ} | variables


def own_python(module: str) -> list[str]:
    """Return the words that run a module in a Python like this one, without what lies in the working folder.

    `python -m` alone looks there first: a run folder of somebody else's could bring a `logging.py` of its own.
    """
    return [sys.executable, "-P", "-m", module]


def set_environment(name: str, value: str) -> None:
    """Set an environment variable of this process, for a library that takes its settings from there."""
    os.environ[name] = value


def environment(name: str, default: str = "") -> str:
    """Return an environment variable; the only reader of the environment."""
    return os.environ.get(name, default)


def cache_root() -> Path:
    """Return the folder of what this user's tools keep: `SAFLITE_CACHE`, or one in the home.

    Who has no home (a container's unknown user) is given the one that Debian gives such users: nothing lies there,
    nothing can be written there, and what needs it says so.
    """
    given = environment("SAFLITE_CACHE")
    try:
        return Path(given) if given else Path.home() / ".cache" / "saflite"
    except RuntimeError:
        return Path("/nonexistent/.cache/saflite")
