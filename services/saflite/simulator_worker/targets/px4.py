"""PX4: the simulator build that a person names, in lockstep with our world; a process for each flight."""

from saflite.contract.flight import Flight
from saflite.contract.standalone import Evidence, Files
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.px4.adapter import ADAPTER
from saflite.flight.autopilots.px4.standalone.export import files_of
from saflite.simulator_worker.targets._external import ExternalTarget

_TARGET = ExternalTarget(ADAPTER)
describe, check, open = _TARGET.describe, _TARGET.check, _TARGET.open  # noqa: A001  (names that the contract gives)
parameters_known = _TARGET.parameters_known
own_network = True  # whoever reaches its ports can give it orders; see `own_network.py`


def standalone(test_case: TestCase, flight: Flight, evidence: Evidence) -> Files:
    """Return what flies a finding on the binary's own physics; raises as `contract/standalone.py` says."""
    return files_of(test_case, flight, evidence, *_TARGET.binary())
