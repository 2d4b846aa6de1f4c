"""The flights of an earlier run worth beginning with: what the strategy `exposure` would have kept of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from saflite.console.run_data.run_folder import open_run
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused
from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Setting
from saflite.contract.work import Outcome

STRATEGY = "exposure"
BUILD_SHOWN = 12


def with_corpus(campaign: Campaign, run_dir: Path, target: TargetInfo) -> Campaign:
    """Return the campaign with the kept flights of an earlier run in the settings of its strategy.

    Raises:
        Refused: the strategy keeps no corpus, or the run is of another target or another build of it.
    """
    if campaign.strategy.name != STRATEGY:
        raise Refused("--corpus", expected=f"a campaign with the strategy {STRATEGY}", got=campaign.strategy.name)
    with open_run(run_dir) as run:
        flown = run.target
        if (flown.name, flown.build) != (target.name, target.build):
            raise Refused(
                "corpus",
                where=str(run_dir),
                expected=f"flights of {target.name}, build {target.build[:BUILD_SHOWN]}",
                got=f"those of {flown.name}, build {flown.build[:BUILD_SHOWN]}",
                fix="how far a flight came says nothing of another target or version; begin without --corpus",
            )
        kept = _kept(run.outcomes())
    strategy = campaign.strategy
    settings: dict[str, Setting] = {**strategy.settings, "corpus": list(kept)}
    return msgspec.structs.replace(campaign, strategy=msgspec.structs.replace(strategy, settings=settings))


def _kept(outcomes: Iterable[Outcome]) -> list[str]:
    from saflite.mutator.exposure.corpus import Corpus
    from saflite.mutator.exposure.progress import by_policy
    from saflite.mutator.exposure.state_model import StateModel

    corpus, states = Corpus(), StateModel()
    for outcome in outcomes:
        if outcome.ending in FLOWN_ENDINGS:
            new = states.tell(outcome.test_case, outcome.transitions)
            corpus.tell(outcome.test_case, by_policy(outcome), new)
    return corpus.sown()
