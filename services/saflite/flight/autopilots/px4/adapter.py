"""PX4 as a target needs it."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from saflite.flight.autopilots.external.adapter import Adapter
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.place import Place
from saflite.flight.autopilots.px4.binary import BINARIES
from saflite.flight.autopilots.px4.bring_up import Aircraft
from saflite.flight.autopilots.px4.check import check_test_case
from saflite.flight.autopilots.px4.describe import describe
from saflite.flight.autopilots.px4.flight import Px4Flight
from saflite.flight.autopilots.px4.settings import NO_LOG, OWN_KIND, QUADROTOR


def _powered_up(binary: Binary, place: Place, parameters: Mapping[str, float]) -> Aircraft:
    given = {name: str(round(value)) for name, value in {**NO_LOG, **parameters}.items()}
    return Aircraft(binary, place, given, np.zeros((0, 8)), own_physics=OWN_KIND in parameters)


def _opening(known: Collection[str]) -> dict[str, float]:
    """Return what has PX4 start on its own physics: it lists the parameters of what runs, and that runs more."""
    return {OWN_KIND: QUADROTOR}


ADAPTER = Adapter(BINARIES, describe, check_test_case, Px4Flight, _powered_up, opening=_opening)
