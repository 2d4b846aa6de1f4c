"""A build asked for its parameters is watched by no sandbox: whatever it says, and however slowly, that ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, cast

import pytest
from external_stand_ins import message

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external import listing
from saflite.flight.autopilots.external.process import Process
from saflite.flight.mavlink.client import Client


class _Teller:
    """The client of a vehicle that tells some parameters at each question, and nothing else."""

    def __init__(self, tells: Callable[[int], Iterable[Any]]) -> None:
        self._tells, self.asked = tells, 0
        self.mav = self

    def wait_for_heartbeat(self, within_s: float) -> bool:
        return True

    def param_request_list_send(self, *_: Any) -> None:
        """What follows is told by `wait`."""

    param_request_read_send = param_request_list_send

    def wait(self, good: Callable[[Any], bool], within_s: float) -> tuple[Any | None, int]:
        self.asked += 1
        return next(filter(good, self._tells(self.asked)), None), 1

    def decoded(self, value: float, kind: int) -> float:
        return value


def _parameter(name: bytes = b"RTL_ALT", index: int = 0, count: int = 1) -> Any:
    return message("PARAM_VALUE", param_id=name, param_value=1.5, param_type=9, param_count=count, param_index=index)


def _listed(teller: _Teller) -> dict[str, listing.Row]:
    return listing.listed(cast(Client, teller))


def test_all_that_a_vehicle_tells_is_listed_what_came_late_too() -> None:
    names = [b"B_ALT", b"A_2", b"_C"]
    teller = _Teller(lambda asked: [_parameter(names[asked - 1], asked - 1, 3)])
    assert list(_listed(teller)) == ["A_2", "B_ALT", "_C"]


def test_a_vehicle_that_keeps_back_what_it_says_it_has_is_not_asked_for_ever() -> None:
    teller = _Teller(lambda asked: [_parameter(index=0, count=listing.PARAMETERS_MAX)])
    with pytest.raises(Unavailable, match=f"told 1 of {listing.PARAMETERS_MAX} parameters"):
        _listed(teller)
    assert teller.asked < 2 * listing.MISSED_MAX


@pytest.mark.parametrize("name", [b"A\nB", b"\x1b[2J", b"A B", b"", b"../x", b"A=1", "\u202eA".encode(), b"\xff"])
def test_what_is_no_name_is_none_of_a_parameter(name: bytes) -> None:
    with pytest.raises(Unavailable, match="by no name"):
        _listed(_Teller(lambda asked: [_parameter(name)]))


def test_more_parameters_than_any_autopilot_has_are_not_waited_for() -> None:
    with pytest.raises(Unavailable, match="told of 60000 parameters"):
        _listed(_Teller(lambda asked: [_parameter(count=60_000)]))


@pytest.mark.parametrize(
    "says",
    [
        "while :; do echo still starting; done",
        "while :; do echo more; sleep 0.01; done",
        "trap '' ALRM TERM HUP INT; while :; do echo I heed no alarm; sleep 0.01; done",
    ],
)
def test_a_build_that_only_ever_prints_is_ended_at_its_age(says: str, tmp_path: Path) -> None:
    """The third kept whoever named it waiting for ever: the bound was an alarm, which a program may ignore."""
    process = Process(["/bin/sh", "-c", says], tmp_path, environment={}, age_max_s=0.3)
    assert not process.wait_for_words("Waiting for connection", 60.0)
    assert process.how_it_ended() == "the autopilot had not done what it was started for after 0.3 s"
    process.end()
