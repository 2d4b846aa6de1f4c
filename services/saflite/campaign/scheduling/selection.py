"""Which candidates of a round are flown: the paper's bands, then score with novelty to break ties, and a random share.

Test cases of a kind (`Score.kind`) are worth the less, the more finds of that kind the flights already chosen promise:
a score counts 1 / (1 + finds) of itself. So a campaign spreads over behaviours before their finds are back.

Pure: the choice depends on the candidates, their scores and what was flown before, never on time or workers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from saflite.campaign.engine.journal import Pick
from saflite.contract.rng import derive
from saflite.contract.score import SCORE_MAX, Band, band
from saflite.contract.test_case import TestCase, draw_key
from saflite.flight.novelty import Features, distances, features

_BAND_RANK: dict[Band, int] = {"interesting": 2, "middling": 1, "dull": 0}


class Rules(NamedTuple):
    """How to choose: `flights` in all, of which a share at random; the random stream is the round's own."""

    flights: int
    random_share: float
    novelty_weight: float
    rng_seed: int
    round: int


class Expected(NamedTuple):
    """What scorers expect: the kind of each candidate, and how many finds of each kind the flights chosen promise."""

    kinds: Mapping[str, str] = MappingProxyType({})
    finds: Mapping[str, float] = MappingProxyType({})


NOTHING = Expected()


def select(
    candidates: Mapping[str, TestCase],
    scores: Mapping[str, float],
    flown: Sequence[Features],
    rules: Rules,
    expected: Expected = NOTHING,
) -> tuple[Pick, ...]:
    """Return the picks of a round in order of rank: those chosen by score first, then the random ones.

    Random picks are drawn from all candidates before any score is looked at, so that flights picked by a scorer can
    be judged against them. `candidates`, `scores` and `expected.kinds` are keyed by the test case's identity.
    """
    count = min(rules.flights, len(candidates))
    keys = {name: draw_key(case) for name, case in candidates.items()}
    names = sorted(candidates, key=keys.__getitem__)
    drawn = _random_picks(names, count, rules)
    shapes = [features(candidates[name]) for name in names]
    apart = distances(shapes, [*flown, *shapes])
    nearness, among = apart[:, : len(flown)].min(axis=1, initial=1.0), apart[:, len(flown) :]
    kinds, finds = [expected.kinds.get(name, "") for name in names], dict(expected.finds)
    random_picks = []
    for name in drawn:
        place = names.index(name)
        count_promise(finds, kinds[place], scores[name])
        novelty = float(nearness[place])
        random_picks.append(Pick(test_case=name, selected_by="random", score=scores[name], novelty=novelty))
        nearness = np.minimum(nearness, among[place])
    rest = [place for place, name in enumerate(names) if name not in set(drawn)]
    chosen: list[Pick] = []
    while rest and len(chosen) + len(drawn) < count:
        worth = {place: scores[names[place]] / (1.0 + finds.get(kinds[place], 0.0)) for place in rest}
        best = max(rest, key=lambda place: _rank(keys[names[place]], worth[place], float(nearness[place]), rules))
        rest.remove(best)
        name = names[best]
        count_promise(finds, kinds[best], scores[name])
        chosen.append(Pick(test_case=name, selected_by="score", score=scores[name], novelty=float(nearness[best])))
        nearness = np.minimum(nearness, among[best])
    return (*chosen, *random_picks)


def _rank(key: str, score: float, novelty: float, rules: Rules) -> tuple[int, float, str]:
    """Return what the choice goes by; rounded, so that the last bit of a sum decides nothing on any machine."""
    return (_BAND_RANK[band(score)], round(score + rules.novelty_weight * novelty, 9), key)


def count_promise(finds: dict[str, float], kind: str, score: float) -> None:
    """Count the finds, 0 to 1, that a flight with this score promises of its kind; nothing where it has none."""
    if kind:
        finds[kind] = finds.get(kind, 0.0) + score / SCORE_MAX


def _random_picks(names: list[str], count: int, rules: Rules) -> list[str]:
    """Return `count x random_share` names, the fraction rounded up by chance so that the share holds on average."""
    rng = derive(rules.rng_seed, "select", rules.round)
    share = count * rules.random_share
    many = min(count, int(np.floor(share + rng.random())))
    return [names[place] for place in rng.choice(len(names), size=many, replace=False)] if many else []
