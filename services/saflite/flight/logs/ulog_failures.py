"""What a PX4 log tells of the motors' load, and of an attitude that was lost for good.

PX4 does not say that it crashed. Its failure detector says that roll or pitch passed FD_FAIL_R or FD_FAIL_P for a
while (`failure_detector_status`, up to 1.12 bits of `vehicle_status`); who is still tumbling, or was terminated for it,
when the motors stop or the log ends, came down so, and so did who hit something within seconds of it, as the
accelerometer tells, however it lies then. It does not watch in ACRO, nor where one of the two is set to 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from saflite.contract.signals import MODES
from saflite.flight.logs.hits import struck
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.topics import Column, Topics, field, held

_MOTORS_MAX = 12  # actuator_motors.NUM_CONTROLS
_ATTITUDE = 1 | 2  # vehicle_status.FAILURE_ROLL, FAILURE_PITCH
_HIT_MPS2 = 100.0  # ten times what gravity pulls with: no landing gear takes that in a landing
_LIMITS = ("FD_FAIL_R", "FD_FAIL_P")
_ENDED = (("vehicle_control_mode", "flag_control_termination_enabled"), ("actuator_armed", "force_failsafe"))
SOURCES = {
    "crashed": "failure_detector_status or vehicle_status.failure_detector_status: an attitude that was lost for good",
    "throttle": "actuator_motors, while armed",
}


def add_throttle(topics: Topics, columns: Columns) -> None:
    """Add `throttle`, the mean of what the motors are told. Disarmed it is not known: outputs then heed no command."""
    armed = columns.get("armed")
    motors = [one for i in range(_MOTORS_MAX) if (one := field(topics, "actuator_motors", f"control[{i}]")) is not None]
    if armed is None or not motors:
        return
    told = np.array([values for _, values in motors])
    runs = np.isfinite(told)
    mean = np.where(runs, told, 0.0).sum(axis=0) / np.maximum(runs.sum(axis=0), 1)  # stopped by themselves: 0
    at_s = np.union1d(motors[0][0], armed[0])
    columns.hold("throttle", at_s, np.where(held(armed, at_s) > 0, held((motors[0][0], mean), at_s), np.nan))


def add_crash(
    topics: Topics, parameters: Mapping[str, float], changes: Iterable[tuple[float, str, float]], columns: Columns
) -> bool:
    """Add `crashed` where the log can tell; return whether it crashed."""
    armed, landed, lost = columns.get("armed"), columns.get("landed"), _lost(topics)
    limits = [parameters.get(name, 1.0) for name in _LIMITS] + [value for _, name, value in changes if name in _LIMITS]
    if armed is None or landed is None or lost is None or min(limits) <= 0.0:
        return False
    mode = columns.get("mode") or (armed[0], np.zeros(len(armed[0])))
    ends = [end for place in _ENDED if (end := field(topics, *place)) is not None]
    at_s = np.unique(np.concatenate([column[0] for column in (armed, landed, lost, mode, *ends)]))
    falls = (held(lost, at_s) > 0) & (at_s >= lost[0][0])
    falls |= _since_a_hit(at_s, falls, held(armed, at_s) > 0, _hits(topics))
    ended = np.max([held(end, at_s) for end in ends], axis=0) > 0 if ends else np.zeros(len(at_s), dtype=np.bool_)
    crashed = _crashes(
        held(armed, at_s) > 0,
        held(landed, at_s) > 0,
        falls,
        ended,
        held(mode, at_s) == MODES["ACRO"],
    )
    columns.hold("crashed", at_s, crashed)
    return bool((crashed == 1.0).any())


def _lost(topics: Topics) -> Column | None:
    """Return when the detector said that roll or pitch had failed."""
    roll, pitch = (field(topics, "failure_detector_status", name) for name in ("fd_roll", "fd_pitch"))
    if roll is not None and pitch is not None:
        return roll[0], np.maximum(roll[1], pitch[1])
    bits = field(topics, "vehicle_status", "failure_detector_status")
    return None if bits is None else (bits[0], (bits[1].astype(np.int64) & _ATTITUDE > 0).astype(np.float64))


def _hits(topics: Topics) -> NDArray[np.float64]:
    """Return when the accelerometer measured a hit (s), shape (n,)."""
    axes = [one for i in range(3) if (one := field(topics, "sensor_combined", f"accelerometer_m_s2[{i}]")) is not None]
    if not axes:
        return np.empty(0)
    pulled = np.sqrt(np.sum([values**2 for _, values in axes], axis=0))
    return np.asarray(axes[0][0][pulled >= _HIT_MPS2], dtype=np.float64)


def _since_a_hit(
    at_s: NDArray[np.float64], lost: NDArray[np.bool_], armed: NDArray[np.bool_], hits_s: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return from where a vehicle lies that hit something just after its attitude was lost, until it is disarmed."""
    hits_s = hits_s[armed[np.maximum(np.searchsorted(at_s, hits_s, side="right") - 1, 0)]]
    hit_s = struck(hits_s, at_s[lost & armed], np.append(at_s[~armed], at_s[-1]))
    off_s = np.append(at_s[~armed], np.inf)
    until_s = off_s[np.searchsorted(off_s, hit_s, side="right")]
    begun, over = (np.searchsorted(np.sort(ends), at_s, side="right") for ends in (hit_s, until_s))
    return np.asarray(begun > over)


def _crashes(
    armed: NDArray[np.bool_],
    landed: NDArray[np.bool_],
    lost: NDArray[np.bool_],
    ended: NDArray[np.bool_],
    blind: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return, shape (n,), 1 from where the attitude was lost for good, NaN where that is not known.

    Args:
        armed, landed, lost: as the autopilot says; shape (n,), and so are the others.
        ended: flight was terminated, after which the detector does not watch any more.
        blind: it does not watch.
    """
    crashed, since, now = np.zeros(len(armed)), None, 0.0
    for place in range(len(armed)):
        before = place > 0 and bool(armed[place - 1])
        if armed[place]:
            since = None if not before else since
            if lost[place]:
                since = place if since is None else since
            elif not ended[place]:
                since = None
            now = np.nan if blind[place] else 0.0
        elif before:
            now = 0.0 if landed[place] else np.nan
        if since is not None and (place == len(armed) - 1 or not armed[place]):
            crashed[since:place], now = 1.0, 1.0
        crashed[place] = now
    return crashed
