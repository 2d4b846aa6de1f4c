"""The scaling rule by itself: grow at once, shrink to the greatest need of the window, idle workers first."""

from __future__ import annotations

import msgspec
import pytest

from saflite.contract.control import Status
from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.runtime.autoscaling import STABILIZATION_S, Autoscaler, Bounds, Change, check_bounds, parse_bounds

COUNTS = (
    *("round", "budget", "flights", "reflown", "test_cases", "candidates", "violations_confirmed", "violations_flaky"),
    *("violations_pending", "quarantined", "fallbacks", "seq", "flights_per_s", "real_time_factor", "elapsed_s"),
)


def _status(queued: int, leases: dict[str, int] | None = None, state: str = "running") -> Status:
    names = {"campaign": "night", "state": state, "scorer": "embedded", "scorer_pending": "", "since_last_find_s": None}
    workers = [
        {
            "worker": name,
            "stage": "fly",
            "state": "busy",
            "leases": count,
            "done": 0,
            "busy_share": 0.0,
            "silent_s": 0.0,
        }
        for name, count in (leases or {}).items()
    ]
    return msgspec.convert({**names, **dict.fromkeys(COUNTS, 0), "queues": {"fly": queued}, "workers": workers}, Status)


def _names(count: int) -> list[str]:
    return [f"fly-{number}" for number in range(1, count + 1)]


def _asked(scaler: Autoscaler, status: Status, count: int, now_s: float) -> Change:
    return next(iter(scaler.changes(status, {"fly": _names(count)}, now_s)), Change("fly"))


@pytest.mark.parametrize(("queued", "have", "grow"), [(0, 2, 0), (5, 2, 3), (5, 5, 0), (900, 2, 6), (900, 8, 0)])
def test_a_deep_queue_grows_its_stage_at_once_up_to_the_most(queued: int, have: int, grow: int) -> None:
    assert _asked(Autoscaler({"fly": Bounds(2, 8)}), _status(queued), have, 0.0) == Change("fly", grow=grow)


def test_a_queue_that_runs_dry_between_two_rounds_costs_no_worker() -> None:
    scaler = Autoscaler({"fly": Bounds(1, 8)})
    for second in range(200):
        queued = 8 if second % 20 == 0 else 0
        assert _asked(scaler, _status(queued), 8, float(second)) == Change("fly")


def test_a_queue_that_stays_shallow_shrinks_its_stage_to_what_the_window_needed() -> None:
    scaler = Autoscaler({"fly": Bounds(1, 8)})
    assert _asked(scaler, _status(8), 8, 0.0) == Change("fly")
    assert _asked(scaler, _status(3, {"fly-8": 1}), 8, 1.0) == Change("fly")
    assert _asked(scaler, _status(0), 8, STABILIZATION_S - 0.1) == Change("fly")
    late = _asked(scaler, _status(0, {"fly-8": 1, "fly-2": 2}), 8, STABILIZATION_S + 1.0)
    assert late == Change("fly", drain=("fly-7", "fly-6", "fly-5", "fly-4", "fly-3"))
    assert _asked(scaler, _status(0), 3, 2 * STABILIZATION_S + 1.1) == Change("fly", drain=("fly-3", "fly-2"))


def test_books_that_were_away_for_long_shrink_nothing_by_their_first_word() -> None:
    scaler = Autoscaler({"fly": Bounds(1, 8)})
    assert _asked(scaler, _status(8), 8, 0.0) == Change("fly")
    assert _asked(scaler, _status(0), 8, 10 * STABILIZATION_S) == Change("fly")


def test_what_workers_of_others_hold_asks_for_none_of_ours() -> None:
    assert _asked(Autoscaler({"fly": Bounds(0, 8)}), _status(20, {"lab-fly-1": 18}), 1, 0.0) == Change("fly", grow=1)


def test_a_paused_campaign_keeps_only_those_who_still_work() -> None:
    scaler = Autoscaler({"fly": Bounds(0, 8)})
    assert _asked(scaler, _status(20, {"fly-1": 1}, "paused"), 3, 0.0) == Change("fly", drain=("fly-3", "fly-2"))


def test_an_ended_campaign_changes_nothing() -> None:
    assert _asked(Autoscaler({"fly": Bounds(0, 8)}), _status(5, state="ended"), 1, 0.0) == Change("fly")


def test_whatever_the_queue_does_the_bounds_hold_and_no_worker_needed_leaves() -> None:
    rng = derive(4, "autoscaling")
    for _ in range(30):
        least = int(rng.integers(0, 4))
        most = int(rng.integers(max(1, least), 12))
        scaler, ours, now_s = Autoscaler({"fly": Bounds(least, most)}), _names(least), 0.0
        for step in range(60):
            busy = {name: 1 for name in ours if rng.random() < 0.5}
            queued = len(busy) + int(rng.integers(0, 6))
            now_s += float(rng.exponential(5.0))
            change = next(iter(scaler.changes(_status(queued, busy), {"fly": ours}, now_s)), Change("fly"))
            assert not set(change.drain) & busy.keys()
            assert set(change.drain) <= set(ours)
            ours = [name for name in ours if name not in change.drain]
            ours += [f"fly-{100 * step + number}" for number in range(100, 100 + change.grow)]
            assert least <= len(ours) <= most
            assert len(ours) >= min(queued, most)


def test_bounds_are_read_from_the_command_line() -> None:
    assert parse_bounds(["fly=0:16", "score=1:1"]) == {"fly": Bounds(0, 16), "score": Bounds(1, 1)}


@pytest.mark.parametrize(
    "text",
    ["fly=8:2", "fly=-1:2", "fly=0:0", "fly=1:1001", "fly=2", "fly", "=1:2", "books=1:2", "pilot=1:2"],
)
def test_bounds_that_make_no_sense_are_refused(text: str) -> None:
    with pytest.raises(Refused, match="--scale"):
        parse_bounds([text])


@pytest.mark.parametrize("text", ["fly=a:b", "fly=1.5:2", "fly=1:²", "fly=1:99999999999999999999", "fly=1:2:3", ""])
def test_bounds_that_are_no_numbers_are_refused(text: str) -> None:
    with pytest.raises(Refused, match="expected STAGE=MIN:MAX"):
        parse_bounds([text])


def test_a_stage_is_bounded_once() -> None:
    with pytest.raises(Refused, match="each once"):
        parse_bounds(["fly=1:2", "fly=1:3"])


def test_bounds_of_a_file_are_held_to_the_same() -> None:
    with pytest.raises(Refused, match=r"farm\.toml.*min 3, max 1"):
        check_bounds({"fly": Bounds(3, 1)}, "scale", "farm.toml")
