"""Betaflight with GPS, altitude hold, position hold and rescue: the target to begin with."""

from saflite.simulator_worker.targets._betaflight import target

_TARGET = target("betaflight", "gps")
describe, check, open = _TARGET.describe, _TARGET.check, _TARGET.open  # noqa: A001  (names that the contract gives)
standalone = _TARGET.standalone
