"""The launchers, over real processes and a real router."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from saflite.conformance.kit import findings
from saflite.conformance.launchers import NO_BOOKS, check_launcher
from saflite.contract.errors import Refused
from saflite.runtime.launchers import local
from saflite.runtime.launchers.base import Meeting, RoleState
from saflite.runtime.launchers.local import LocalLauncher
from saflite.simulator_worker.processes import children

pytestmark = pytest.mark.live


def test_the_local_launcher(tmp_path: Path) -> None:
    before = children(os.getpid())
    assert findings(check_launcher(lambda meeting: LocalLauncher(meeting, tmp_path))) == []
    assert children(os.getpid()) == before


class Forgetful(LocalLauncher):
    """Breaks the rules: tells of nothing that ended, and takes a name twice."""

    def start(self, spec: object) -> None:
        try:
            super().start(spec)  # type: ignore[arg-type]
        except Refused:
            self.stop([spec.name])  # type: ignore[attr-defined]
            super().start(spec)  # type: ignore[arg-type]

    def poll(self) -> dict[str, RoleState]:
        return {name: state for name, state in super().poll().items() if state.condition == "running"}


def test_the_checks_find_a_launcher_that_breaks_the_rules(tmp_path: Path) -> None:
    made: list[Forgetful] = []

    def factory(meeting: Meeting) -> Forgetful:
        made.append(Forgetful(meeting, tmp_path))
        return made[-1]

    found = {finding.check for finding in findings(check_launcher(factory))}
    assert found >= {"a name runs once", "how a role ended is told and it may start again"}
    assert all(not launcher.pids() for launcher in made)


def test_who_does_not_stop_when_asked_is_killed_with_what_it_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "STOP_GRACE_S", 0.5)
    stubborn = ("sh", "-c", 'trap "" TERM; sleep 1000 & while :; do wait; done', "sh")
    launcher = LocalLauncher(
        Meeting(campaign="c", connect="tcp/127.0.0.1:9", insecure=True), tmp_path, prefix_of=lambda _: stubborn
    )
    before = children(os.getpid())
    launcher.start(NO_BOOKS)
    group = next(iter(launcher.pids().values()))
    while not children(group):
        launcher.poll()
    launcher.stop()
    assert children(os.getpid()) == before
    with pytest.raises(ProcessLookupError):
        os.killpg(group, 0)
