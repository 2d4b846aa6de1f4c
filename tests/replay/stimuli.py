"""Short words for the stimuli of test cases written by hand."""

from __future__ import annotations

from saflite.contract.test_case import Stimulus, StimulusKind


def given(at_s: float, kind: StimulusKind, name: str, *values: float) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)


def mode(at_s: float, name: str) -> Stimulus:
    return given(at_s, "mode", name)


def stick(at_s: float, number: int, pwm: float) -> Stimulus:
    return given(at_s, "stick", f"RC{number}", pwm)


def setting(at_s: float, name: str, value: float) -> Stimulus:
    return given(at_s, "parameter", name, value)


def fault(at_s: float, name: str, value: float) -> Stimulus:
    return given(at_s, "sensor_fault", name, value)
