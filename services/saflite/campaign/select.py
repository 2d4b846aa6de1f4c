"""Which candidates of a round are flown: the paper's bands, then score with novelty to break ties, and a random share.

Pure: the choice depends on the candidates, their scores and what was flown before, never on time or workers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from saflite.campaign.entries import Pick
from saflite.campaign.novelty import Features, features, novelty
from saflite.contract.rng import derive
from saflite.contract.score import Band, band
from saflite.contract.test_case import TestCase

_BAND_RANK: dict[Band, int] = {"interesting": 2, "middling": 1, "dull": 0}


class Rules(NamedTuple):
    """How to choose: `flights` in all, of which a share at random; the random stream is the round's own."""

    flights: int
    random_share: float
    novelty_weight: float
    rng_seed: int
    round: int


def select(
    candidates: Mapping[str, TestCase], scores: Mapping[str, float], flown: Sequence[Features], rules: Rules
) -> tuple[Pick, ...]:
    """Return the picks of a round in order of rank: those chosen by score first, then the random ones.

    Random picks are drawn from all candidates before any score is looked at, so that flights picked by a scorer can
    be judged against them. `candidates` and `scores` are keyed by the test case's identity.
    """
    count = min(rules.flights, len(candidates))
    drawn = _random_picks(sorted(candidates), count, rules)
    shapes = {name: features(test_case) for name, test_case in candidates.items()}
    seen = [*flown, *(shapes[name] for name in drawn)]
    nearness = {name: novelty(shapes[name], seen) for name in sorted(candidates)}
    random_picks = [
        Pick(test_case=name, selected_by="random", score=scores[name], novelty=nearness[name]) for name in drawn
    ]
    chosen: list[Pick] = []
    rest = {name: nearness[name] for name in sorted(candidates) if name not in set(drawn)}
    while rest and len(chosen) + len(drawn) < count:
        best = max(
            rest, key=lambda name: (_BAND_RANK[band(scores[name])], _value(scores[name], rest[name], rules), name)
        )
        chosen.append(Pick(test_case=best, selected_by="score", score=scores[best], novelty=rest.pop(best)))
        for name in rest:
            rest[name] = min(rest[name], novelty(shapes[name], [shapes[best]]))
    return (*chosen, *random_picks)


def _value(score: float, how_novel: float, rules: Rules) -> float:
    return score + rules.novelty_weight * how_novel


def _random_picks(names: list[str], count: int, rules: Rules) -> list[str]:
    """Return `count x random_share` names, the fraction rounded up by chance so that the share holds on average."""
    rng = derive(rules.rng_seed, "select", rules.round)
    share = count * rules.random_share
    many = min(count, int(np.floor(share + rng.random())))
    return [names[place] for place in rng.choice(len(names), size=many, replace=False)] if many else []
