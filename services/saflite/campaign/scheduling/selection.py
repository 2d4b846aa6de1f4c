"""Which candidates of a round are flown: the paper's bands, then score with novelty to break ties, and a random share.

Pure: the choice depends on the candidates, their scores and what was flown before, never on time or workers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from saflite.campaign.engine.journal import Pick
from saflite.contract.rng import derive
from saflite.contract.score import Band, band
from saflite.contract.test_case import TestCase, draw_key
from saflite.flight.novelty import Features, distances, features, nearest

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
    keys = {name: draw_key(case) for name, case in candidates.items()}
    names = sorted(candidates, key=keys.__getitem__)
    drawn = _random_picks(names, count, rules)
    shapes = [features(candidates[name]) for name in names]
    nearness = nearest(shapes, flown)
    among = distances(shapes, shapes)
    random_picks = []
    for name in drawn:
        place = names.index(name)
        novelty = float(nearness[place])
        random_picks.append(Pick(test_case=name, selected_by="random", score=scores[name], novelty=novelty))
        nearness = np.minimum(nearness, among[place])
    rest = [place for place, name in enumerate(names) if name not in set(drawn)]
    chosen: list[Pick] = []
    while rest and len(chosen) + len(drawn) < count:
        best = max(
            rest, key=lambda place: _rank(keys[names[place]], scores[names[place]], float(nearness[place]), rules)
        )
        rest.remove(best)
        name = names[best]
        chosen.append(Pick(test_case=name, selected_by="score", score=scores[name], novelty=float(nearness[best])))
        nearness = np.minimum(nearness, among[best])
    return (*chosen, *random_picks)


def _rank(key: str, score: float, novelty: float, rules: Rules) -> tuple[int, float, str]:
    """Return what the choice goes by; rounded, so that the last bit of a sum decides nothing on any machine."""
    return (_BAND_RANK[band(score)], round(score + rules.novelty_weight * novelty, 9), key)


def _random_picks(names: list[str], count: int, rules: Rules) -> list[str]:
    """Return `count x random_share` names, the fraction rounded up by chance so that the share holds on average."""
    rng = derive(rules.rng_seed, "select", rules.round)
    share = count * rules.random_share
    many = min(count, int(np.floor(share + rng.random())))
    return [names[place] for place in rng.choice(len(names), size=many, replace=False)] if many else []
