"""Betaflight with GPS, built with address and undefined-behaviour sanitizers: slow, and dies of what they find."""

from saflite.simulator_worker.targets._betaflight import target

_TARGET = target("betaflight_sanitized", "sanitized")
describe, check, open = _TARGET.describe, _TARGET.check, _TARGET.open  # noqa: A001  (names that the contract gives)
standalone = _TARGET.standalone
