"""What a build violates that another does not: both searched alike, what only one shows flown again on both."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from saflite.campaign.storage.own_folder import STORE
from saflite.campaign.storage.store import campaign_of
from saflite.console.operations import builds, running
from saflite.console.operations.builds import Benches, Build, Sample, fresh_noises
from saflite.console.operations.chances import Count, chance_greater
from saflite.console.operations.regressing import WITHHELD
from saflite.console.run_data import known, reporting
from saflite.console.run_data.known import Known
from saflite.console.view.ci_files import Check
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import Target
from saflite.contract.verdict import modes_named

SEARCHES = ("old", "new")
FIX = "choose another --out"


class Compared(NamedTuple):
    """A find on the new build: its flights on both, the chance that it violates more often there."""

    known: Known
    old: Count
    new: Count
    lost: int
    chance: float
    memory_safety: bool = False

    def is_new(self, confidence: float) -> bool:
        """Whether it is shown to be new."""
        return self.chance >= confidence

    def is_unsaid(self, confidence: float) -> bool:
        """Whether it is not shown to be new, and flights are missing that could have shown it."""
        return not self.is_new(confidence) and bool(self.lost or not self.old[1] or not self.new[1])


class Difference(NamedTuple):
    """What came of both searches. `shared` counts behaviours that both searches found."""

    compared: tuple[Compared, ...]
    shared: int
    found: tuple[int, int]
    flights: tuple[int, int]


def searched(campaign: Campaign, build: Build, run_dir: Path, workers: int | None, *, quiet: bool) -> int:
    """Run the campaign on a build, or go on with it where it was left; returns its first flights.

    Raises:
        Refused: the build cannot fly here, or the run that stands there is of another campaign or damaged.
        Unavailable: the farm cannot start, or the search was stopped, or broke, before its end.
    """
    from saflite.console.view import live
    from saflite.runtime import campaign_runner
    from saflite.simulator_worker.registry import describe_target

    builds.use(build)
    if (run_dir / STORE).exists():
        if campaign_of(run_dir) != campaign:
            raise Refused("--out", where=str(run_dir), expected="a run of this campaign", got="one of another", fix=FIX)
        running.check_books(run_dir, accept_loss=False)
    else:
        running.create(run_dir, campaign, describe_target(build.target.name))
    view = live.open_view(run_dir, quiet=quiet)
    try:
        ended = campaign_runner.resume(run_dir, simulators=workers, on_status=view.update)
    finally:
        with suppress(OSError):
            view.close()
    reporting.write(run_dir)
    if not ended.ended:
        raise Unavailable(f"the search of {build.label} was stopped ({ended.why}): there is nothing to compare")
    if ended.failed:
        raise Unavailable(f"the search of {build.label} broke ({ended.why}): there is nothing to compare")
    return ended.status.flights if ended.status else 0


def check_folder(folder: Path) -> None:
    """Raise Refused if a folder is there, unless a comparison began it: that goes on where it was left."""
    if folder.is_dir() and not folder.is_symlink() and {one.name for one in folder.iterdir()} <= set(SEARCHES):
        return
    running.check_new(folder)


def on_build(campaign: Campaign, build: Build) -> Campaign:
    """Return the campaign on a build: its parameters stay, the build's settings stand for those of the file."""
    settings = build.target.settings
    if build.target.name == campaign.target.name:
        settings = {**campaign.target.settings, **settings}
    target = Target(name=build.target.name, parameters=campaign.target.parameters, settings=settings)
    return msgspec.structs.replace(campaign, target=target)


def compare(
    campaign: Campaign,
    old: Build,
    new: Build,
    folder: Path,
    *,
    times: int,
    workers: int | None,
    wall_limit_s: float,
    quiet: bool,
) -> Difference:
    """Search both builds with one campaign and random seed; fly what only the new one showed again on both."""
    flights, finds = [], []
    for name, build in zip(SEARCHES, (old, new), strict=True):
        flights.append(searched(on_build(campaign, build), build, folder / name, workers, quiet=quiet))
        finds.append(known.read(folder / name))
    ways = {(one.policy, one.behaviour) for one in finds[0]}
    only = [one for one in finds[1] if (one.policy, one.behaviour) not in ways]
    counted = {build.label: _flown(only, build, times, wall_limit_s) for build in (old, new)}
    on_old, on_new = counted[old.label], counted[new.label]
    compared = tuple(_compared(one, on_old[at], on_new[at]) for at, one in enumerate(only))
    shared = len({(one.policy, one.behaviour) for one in finds[1]} & ways)
    return Difference(compared, shared, (len(finds[0]), len(finds[1])), (flights[0], flights[1]))


def _flown(only: Sequence[Known], build: Build, times: int, wall_limit_s: float) -> list[list[Sample]]:
    with Benches(wall_limit_s) as benches:
        return [
            [
                benches.of(build).fly(one.test_case, (one.policy,), one.policy_texts, noise)
                for noise in fresh_noises(times)
            ]
            for one in only
        ]


def _compared(one: Known, on_old: Sequence[Sample], on_new: Sequence[Sample]) -> Compared:
    old, new = _count(one, on_old), _count(one, on_new)
    lost = [sample for sample in (*on_old, *on_new) if sample.verdicts is None]
    memory = one.memory_safety or any(sample.memory_safety for sample in (*on_old, *on_new))
    return Compared(one, old, new, len(lost), chance_greater(new, old), memory)


def _count(one: Known, samples: Sequence[Sample]) -> Count:
    verdicts = [verdict for sample in samples if (verdict := sample.of(one.policy)) is not None]
    return sum(1 for verdict in verdicts if verdict.outcome == "violated"), len(verdicts)


def lines(found: Difference, old: Build, new: Build, confidence: float) -> list[str]:
    """Return the result in words: what is new, then what looked new and may not be."""
    fresh = [one for one in found.compared if one.is_new(confidence)]
    doubtful = [one for one in found.compared if not one.is_new(confidence)]
    rows = [f"NEW  {_line(one)}" for one in fresh] + [f"not shown to be new  {_line(one)}" for one in doubtful]
    told = len(found.compared)
    heads = [
        f"{old.label}: {found.flights[0]} flights, {found.found[0]} behaviours",
        f"{new.label}: {found.flights[1]} flights, {found.found[1]} behaviours, {found.shared} of them in both",
    ]
    # what violates equally often on both is told to be new about as often as the confidence leaves room for
    expected = f" (of {told} compared; by chance alone about {told * (1.0 - confidence):.2f} would be told so)"
    summary = f"{len(fresh)} new in {new.label}" + (expected if fresh else "")
    return [*heads, *rows, summary]


def _line(one: Compared) -> str:
    lost = f", {one.lost} flights lost" if one.lost else ""
    return (
        f"{one.known.fingerprint}  {_way(one) or one.known.policy}  test case {one.known.name}  violated in "
        f"{one.old[0]} of {one.old[1]} before, {one.new[0]} of {one.new[1]} now, probability {one.chance:.3f}{lost}"
    )


def _way(one: Compared) -> str:
    """Return the behaviour for people: names of modes in place of numbers."""
    from saflite.simulator_worker.registry import describe_target

    return modes_named(one.known.behaviour, describe_target(one.known.test_case.target.name).modes)


def exit_code(found: Difference, confidence: float) -> int:
    """Return 1 where something is new, 3 where a search or flight that could have shown it failed, else 0."""
    if any(one.is_new(confidence) for one in found.compared):
        return 1
    unsaid = any(one.is_unsaid(confidence) for one in found.compared)
    return 3 if unsaid or not all(found.flights) else 0


def check(one: Compared, confidence: float) -> Check:
    """Return it as a row for JUnit and SARIF."""
    fresh = one.is_new(confidence)
    return Check(
        rule=one.known.policy,
        name=f"{one.known.fingerprint} {one.known.name}",
        outcome="failed" if fresh else "error" if one.is_unsaid(confidence) else "skipped",
        text=f"{'new' if fresh else 'not shown to be new'}: {WITHHELD if one.memory_safety else _line(one)}",
        level="error" if one.known.severity == "hard" else "warning",
        baseline="new" if fresh else "unchanged",
        fingerprint=one.known.fingerprint,
        place=one.known.file,
    )


def plain(found: Difference, confidence: float) -> dict[str, Any]:
    """Return the result for scripts."""
    return {
        "flights": found.flights,
        "behaviours": found.found,
        "in_both": found.shared,
        "confidence": confidence,
        "finds": [
            {
                "new": one.is_new(confidence),
                "fingerprint": one.known.fingerprint,
                "test_case": one.known.name,
                "policy": one.known.policy,
                "behaviour": _way(one),
                "before": one.old,
                "now": one.new,
                "lost": one.lost,
                "probability": one.chance,
            }
            for one in found.compared
        ],
    }
