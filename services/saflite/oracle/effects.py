"""Excuses: which stimuli falsify what the vehicle senses or can do, and for how long.

A flag such as `baro_settled` is 0 while a stimulus disturbs what it stands for. An effect that passes (a jump of the
barometer, a lost receiver, a calibration) counts until the estimator has followed it; one that goes on (noise, drift, a
dead motor) counts while it is in force, and then until the vehicle has recovered. Only causes that can bring the effect
about count: not a low battery, not a motor "failed" at full output, not a breeze.

Times: a GPS position beyond the gate is rejected for 10 s, then believed (ArduPilot, EKF2 `EK2_POS_I_GATE`, reset after
10 s); a change of height is flown off at 1 m/s or faster (PILOT_SPEED_UP and WPNAV_SPEED_UP are 0.5 m/s at least, their
defaults 2.5).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Stimulus
from saflite.oracle.courses import within

FLAGS = ("gps_true", "gps_settled", "baro_true", "baro_settled", "body_true", "sticks_true", "ends_true")
"""`*_true`: the reading is the truth. `*_settled`: the estimate has come to terms with the reading, true or not."""

SETTLE_S = 20.0
LEARNT_S = 40.0
"""A false gyro, compass or accelerometer is learnt as a bias while it lasts and unlearnt in the same time; measured on
the reference: 49 s after a gyro bias of 0.05 rad/s for 60 s the vehicle is level again."""
STRONG_SHARE, STRONG_TIMES = 0.5, 12.0
"""One stronger than half of its documented range takes this many times as long: on the reference a compass off by
0.5 Gauss, or a gyro by 0.2 rad/s, for 9 s leaves it leaning by more than 5 degrees for another 60 s, while it spins for
100 s; at half of that it levels itself at once."""
SLIGHT_RPS = 0.01  # a gyro said to be off by this has a vehicle lean by 3 degrees
SLUGGISH_DPS = 10.0
"""Who may lean no faster swings about the place it holds: ArduCopter 4.5.7 with ATC_RATE_R_MAX 5 by 20 m. Some vehicles
take no limit that low; of these nothing is asked either while one is set."""
WIND_STOOD_MPS, GUSTS_STOOD_MPS = 8.0, 2.0  # a small multirotor holds its place in that much
WIND_SETTLE_S = 5.0
"""Measured on the reference: in a wind of 8 m/s that comes at once, LOITER, BRAKE, GUIDED and LAND are off by at most
0.2 m in the first five seconds, and by no more after; so is ArduCopter 4.5.7, there by 0.22 m."""
_STICK_USUAL = {"trim": 1500.0, "min": 1000.0, "max": 2000.0, "dz": 20.0, "thr_dz": 100.0}


class Effect(NamedTuple):
    """What a stimulus does: the flags it ends until it has settled, those it ends while it is in force, the value at
    which it does nothing, the seconds that a change and each unit of it take to settle, and whether what it
    made of the reading stays when it is taken back: a drift that has stopped leaves its offset; and whether the
    estimator takes it for a bias, see `LEARNT_S`."""

    passing: tuple[str, ...] = ()
    lasting: tuple[str, ...] = ()
    healthy: float = 0.0
    settles_s: float = SETTLE_S
    per_unit_s: float = 0.0
    stays: bool = False
    learnt: bool = False


BLIND = Effect(lasting=("gps_true", "gps_settled", "baro_true", "baro_settled", "body_true"), healthy=1.0)
"""Another set of sources for the estimate: ArduPilot's second and third are empty unless somebody fills them."""
TURNED = Effect(lasting=("body_true",), healthy=-1.0)
"""The compass is told where north is (MAV_CMD_FIXED_MAG_CAL_YAW), which ArduPilot takes in flight, whatever it is."""
_GPS, _BARO = ("gps_true", "gps_settled"), ("baro_true", "baro_settled")
_FAULTS: tuple[tuple[str, Effect], ...] = (
    (r"rc_|radio|batt|para|speedup|pin_mask|engine_fail$", Effect()),  # a motor fails by engine_mul
    (r"gps\w*(noise|rnd)", Effect(lasting=_GPS)),
    (r"gps\w*drift", Effect(lasting=("gps_true",), stays=True)),
    (r"gps\w*(glitch_z|offset_up)", Effect(lasting=("gps_true",))),
    (r"gps\w*(loss|disable)", Effect(passing=_GPS)),
    (r"gps\w*sat", Effect(passing=_GPS, healthy=10.0)),
    (r"gps", Effect(passing=("gps_settled",), lasting=("gps_true",))),
    (r"baro\w*(noise|rnd)", Effect(lasting=_BARO)),
    (r"baro\w*drift", Effect(lasting=_BARO, stays=True)),
    (r"baro\w*(loss|disable)", Effect(passing=_BARO)),
    (r"baro", Effect(passing=("baro_settled",), lasting=("baro_true",), per_unit_s=1.0)),
    (r"engine_mul", Effect(lasting=("body_true",), healthy=1.0)),
    (r"gyr|mag|acc|compass", Effect(lasting=("body_true",), learnt=True)),
    (r"wind_dir", Effect(passing=("body_true",), settles_s=WIND_SETTLE_S)),
    (r"", Effect(lasting=("body_true",))),
)
_SETTINGS: tuple[tuple[str, Effect], ...] = (
    (r"gnd_alt_offset", Effect(passing=("baro_settled",), lasting=("baro_true",), per_unit_s=1.0)),
    (r"gnd_temp", Effect(passing=("baro_settled",), lasting=("baro_true",), per_unit_s=1.0)),
    (r"gnd_primary|ek\d_alt_source|baro", Effect(passing=("baro_settled",), per_unit_s=1.0)),
    (r"ins_gyroffs|compass_of", Effect(lasting=("body_true",))),
    (r"ahrs_trim", Effect(passing=("body_true",))),  # the heading follows: it is reckoned from a field felt askew
    (r"atc_rate_[rp]_max", Effect(lasting=("body_true",))),
    (r"gps_(pos|type|primary|sats)", Effect(passing=("gps_settled",))),
    (r"rc\d+_(option|reversed?)|rc3_m|rcmap_|tune$", Effect(lasting=("sticks_true", "ends_true"))),
    (r"rc\d+_(trim|dz)|rc3_|thr_dz", Effect(lasting=("sticks_true",))),
)
"""RC1_MIN and the like only scale a stick: its centre and its sense stay. The throttle has no other centre. TUNE gives
channel 6 what a stick or a setting else decides. A setting out of its documented range excuses nothing: it should have
been refused."""


def effect_of(stimulus: Stimulus) -> Effect:
    """Return what a stimulus falsifies, by its name: `SIM_GPS_NOISE` as well as `gps_noise`."""
    name = stimulus.name.lower()
    if stimulus.kind == "command" and name.endswith("set_ekf_source_set"):
        return BLIND
    if stimulus.kind == "command" and "fixed_mag_cal" in name:
        return TURNED
    fault = stimulus.kind == "sensor_fault" or name.startswith("sim_")
    if not fault and stimulus.kind != "parameter":
        return Effect()
    name = name.removeprefix("sim_")
    effect = next((found for pattern, found in (_FAULTS if fault else _SETTINGS) if re.match(pattern, name)), Effect())
    if "sticks_true" in effect.lasting:
        return effect._replace(healthy=_STICK_USUAL.get(name, _STICK_USUAL.get(name.rpartition("_")[2], 0.0)))
    if name.startswith("ins_gyroffs") and all(abs(value) < SLIGHT_RPS for value in stimulus.values):
        return Effect()
    if name.startswith("atc_rate") and not any(0.0 < value < SLUGGISH_DPS for value in stimulus.values):
        return Effect()
    if fault and _stood(name, stimulus.values):
        return Effect(passing=("body_true",), settles_s=WIND_SETTLE_S)
    return effect


def _stood(name: str, values: tuple[float, ...]) -> bool:
    """Say whether it is a wind that a vehicle flies on in."""
    if not name.startswith("wind") or not values:
        return False
    return abs(values[0]) <= (GUSTS_STOOD_MPS if "turb" in name else WIND_STOOD_MPS)


def silencing(kind: str, name: str) -> tuple[str, ...]:
    """Return the flags that an input of this name holds at 0 while it is in force, whatever its value."""
    if kind not in ("parameter", "sensor_fault") or name.lower().removeprefix("sim_").startswith("wind"):
        return ()
    return effect_of(Stimulus(at_s=0.0, kind=kind, name=name)).lasting  # type: ignore[arg-type]


def undisturbed(
    flag: str,
    given: Iterable[Stimulus],
    before: Mapping[str, float],
    times: NDArray[np.float64],
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> NDArray[np.float64]:
    """Return a flag over time, shape (moments,): 0 while a stimulus disturbs what it stands for.

    Args:
        flag: one of FLAGS.
        given: the stimuli, in the order given.
        before: parameters set before the start; what is in force then is in force from the start.
        times: when, shape (moments,).
        ranges: least and greatest value of settings, as documented, by name; others may take any.
    """
    spans: list[tuple[float, float]] = []
    preset = [Stimulus(at_s=-np.inf, kind="parameter", name=name, values=(value,)) for name, value in before.items()]
    held: dict[str, tuple[float, Effect]] = {}
    since: dict[str, float] = {}
    for one in (*preset, *given):
        effect, name = effect_of(one), one.name.lower().removeprefix("sim_")
        value = one.values[0] if one.values else effect.healthy + 1.0
        low, high = (ranges or {}).get(one.name, (-np.inf, np.inf))
        if not low <= value <= high:
            continue
        old, old_effect = held.get(name, (effect.healthy, effect))
        if value == old or flag not in {*effect.passing, *effect.lasting, *old_effect.lasting}:
            continue
        settled_s = one.at_s + effect.settles_s + abs(value - old) * effect.per_unit_s
        if effect.stays and flag.endswith("_true"):
            settled_s = np.inf
        spans.append((one.at_s - 1e-9, settled_s))
        if name in since:
            start_s = since.pop(name)
            settled_s += _unlearnt_s(old, (low, high), one.at_s - start_s) if effect.learnt else 0.0
            spans.append((start_s - 1e-9, settled_s))
        if flag in effect.lasting and value != effect.healthy:
            since[name] = one.at_s
        held[name] = (value, effect)
    spans += [(start_s - 1e-9, np.inf) for start_s in since.values()]
    return (~within(spans, times)).astype(np.float64)


def _unlearnt_s(offset: float, limits: tuple[float, float], lasted_s: float) -> float:
    """Return how long the estimator takes to unlearn an offset that it took for a bias."""
    greatest = max(abs(limit) for limit in limits)
    strong = STRONG_SHARE * greatest < abs(offset)
    return min(LEARNT_S, lasted_s) * (STRONG_TIMES if strong else 1.0)
