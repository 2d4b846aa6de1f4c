"""Chances worked out from counts of flights that violated: which of two rates is greater, where in a row it changed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Count = tuple[int, int]
"""Flights that violated, flights judged."""

BY_NOISE = (1.0, 49.0)
"""Beta prior of the rate at which a build without the fault violates: about 2 %, by noise alone."""
BY_FAULT = (2.0, 1.0)
"""Beta prior of the rate at which a build with the fault violates: rather often than seldom."""


def log_beta(a: float, b: float) -> float:
    """Return the logarithm of Euler's beta function."""
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)


def chance_greater(here: Count, there: Count) -> float:
    """Return the chance that the rate behind `here` is above the one behind `there`, flat priors on both.

    Closed form for whole-numbered Beta posteriors (E. Miller, Formulas for Bayesian A/B testing, 2014).
    """
    a_here, b_here = 1 + here[0], 1 + here[1] - here[0]
    a_there, b_there = 1 + there[0], 1 + there[1] - there[0]
    return min(1.0, sum(
        math.exp(
            log_beta(a_there + i, b_here + b_there)
            - math.log(b_here + i) - log_beta(1 + i, b_here) - log_beta(a_there, b_there)
        )
        for i in range(a_here)
    ))  # fmt: skip


Change = Literal["broke", "fixed", "never", "always"]


class Hypothesis(NamedTuple):
    """What may have happened over builds in order: at `place` the first build that differs from those before."""

    change: Change
    place: int


class Belief(NamedTuple):
    """The chance of every hypothesis, shape (hypotheses,), given the counts on each build."""

    hypotheses: tuple[Hypothesis, ...]
    chances: NDArray[np.float64]

    @property
    def best(self) -> tuple[Hypothesis, float]:
        """The likeliest hypothesis and its chance."""
        at = int(self.chances.argmax())
        return self.hypotheses[at], float(self.chances[at])


def _hypotheses(builds: int) -> tuple[Hypothesis, ...]:
    places = range(1, builds)
    ends = (Hypothesis("never", 0), Hypothesis("always", 0))
    return (*ends, *(Hypothesis("broke", at) for at in places), *(Hypothesis("fixed", at) for at in places))


def _faulty(builds: int, hypotheses: Sequence[Hypothesis]) -> NDArray[np.bool_]:
    """Return which builds have the fault under each hypothesis, shape (hypotheses, builds)."""
    after = np.arange(builds)[None, :] >= np.array([one.place for one in hypotheses])[:, None]
    change = np.array([one.change for one in hypotheses])[:, None]
    return np.where(np.isin(change, ("broke", "always")), after, (change == "fixed") & ~after)


def believe(counts: Sequence[Count]) -> Belief:
    """Return the chances over builds in order, every hypothesis as likely as any other before the first flight.

    The builds with the fault share one rate of violating, those without another (`BY_FAULT`, `BY_NOISE`), both
    integrated out: Beta-binomial likelihoods.
    """
    hypotheses = _hypotheses(len(counts))
    bad = _faulty(len(counts), hypotheses).astype(np.float64)
    table = np.array(counts, dtype=np.float64)
    hits, misses = table[:, 0], table[:, 1] - table[:, 0]
    logs = np.array([
        _evidence(BY_FAULT, row @ hits, row @ misses) + _evidence(BY_NOISE, (1 - row) @ hits, (1 - row) @ misses)
        for row in bad
    ])  # fmt: skip
    weights = np.exp(logs - logs.max())
    return Belief(hypotheses, weights / weights.sum())


def _evidence(prior: tuple[float, float], hits: float, misses: float) -> float:
    return log_beta(prior[0] + hits, prior[1] + misses) - log_beta(*prior)


def most_telling(counts: Sequence[Count], belief: Belief) -> int:
    """Return the build whose next flight is expected to tell most: the least entropy left on average."""
    bad = _faulty(len(counts), belief.hypotheses)
    table = np.array(counts, dtype=np.float64)
    hits, misses = table[:, 0], table[:, 1] - table[:, 0]
    with_fault = _predicted(BY_FAULT, bad @ hits, bad @ misses)
    without = _predicted(BY_NOISE, ~bad @ hits, ~bad @ misses)
    violates = np.where(bad, with_fault[:, None], without[:, None])  # (hypotheses, builds)
    weights = belief.chances[:, None]
    left = sum((weights * answer).sum(axis=0) * _entropy(weights * answer) for answer in (violates, 1.0 - violates))
    return int(np.argmin(left))


def _predicted(
    prior: tuple[float, float], hits: NDArray[np.float64], misses: NDArray[np.float64]
) -> NDArray[np.float64]:
    found: NDArray[np.float64] = (prior[0] + hits) / (sum(prior) + hits + misses)
    return found


def _entropy(joint: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the entropy of each column once it is normalised."""
    shares = joint / np.maximum(joint.sum(axis=0), 1e-300)
    found: NDArray[np.float64] = -(shares * np.log(np.maximum(shares, 1e-300))).sum(axis=0)
    return found
