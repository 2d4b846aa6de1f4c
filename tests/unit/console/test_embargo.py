"""Findings of memory safety stay out of what others see until each is released."""

from __future__ import annotations

from saflite.console.run_data.embargo import ALL, is_public
from saflite.contract.circumstances import Circumstances
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.contract.verdict import Violation
from saflite.recorder.summary import Finding


def finding(memory_safety: bool) -> Finding:
    violation = Violation(
        fingerprint="ab" * 8,
        test_case="cd" * 8,
        policy="autopilot-alive",
        robustness=-1.0,
        severity="hard",
        confirmation="confirmed",
    )
    case = TestCase(target=Target(), scenario=Scenario(start=StartState()))
    circumstances = Circumstances(
        values="inside", link="trusted", stock=True, repeats="bitwise", memory_safety=memory_safety
    )
    return Finding(violation, case, circumstances=circumstances)


def test_only_memory_safety_is_kept_back_and_only_until_released() -> None:
    assert is_public(finding(False), ())
    assert not is_public(finding(True), ())
    assert not is_public(finding(True), ("cd",))
    assert is_public(finding(True), ("abab",))
    assert is_public(finding(True), (ALL,))
