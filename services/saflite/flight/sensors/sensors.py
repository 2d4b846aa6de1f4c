"""Sensors: truth to raw readings with seeded noise and faults (`native/sensors.c`).

    sensors = Sensors(rng_seed=1)
    sensors.set_fault("gps_offset_north", 3.0)
    readings = sensors.read(world.step(throttles))

Native code reads them through `native/sensors.h`, given `Sensors.address`.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.rng import derive_seed
from saflite.flight.native_library import Board, Memory, python_library, slot_names, struct_size
from saflite.flight.sensors.faults import FAULTS
from saflite.flight.world.state import WorldState

STREAMS = ("imu", "baro", "gps", "compass")
FAULT = "fault_"


class Readings(NamedTuple):
    """What the parts say: inertial unit at every step, barometer, battery and range finder at 50 Hz, GPS and compass at
    10 Hz; between, the last reading stays. Body axes forward, right, down; heights up.
    """

    gyro_x_rps: float
    gyro_y_rps: float
    gyro_z_rps: float
    acc_x_mps2: float
    acc_y_mps2: float
    acc_z_mps2: float
    compass_x_gauss: float
    compass_y_gauss: float
    compass_z_gauss: float
    baro_m: float
    baro_alive: float
    gps_north_m: float
    gps_east_m: float
    gps_up_m: float
    gps_vn_mps: float
    gps_ve_mps: float
    gps_vd_mps: float
    gps_satellites: float
    rangefinder_m: float
    pack_v: float
    pack_a: float
    pack_used_mah: float


@cache
def _library() -> ctypes.PyDLL:
    library, pointer = python_library(), ctypes.c_void_p
    library.sensors_start.argtypes = [pointer, pointer]
    library.sensors_read.argtypes = [pointer, pointer]
    assert slot_names("sensors") == (*Readings._fields, *(FAULT + name for name in FAULTS))
    return library


class Sensors(Board):
    """Inertial unit, barometer, GPS, compass, battery and range finder of one vehicle.

    Args:
        rng_seed: each sensor draws from a stream of its own, so none shifts another's noise.
        memory: where the native struct lies; its own by default.
    """

    def __init__(self, rng_seed: int, memory: Memory | None = None) -> None:
        memory = ctypes.create_string_buffer(struct_size("sensors")) if memory is None else memory
        library = _library()
        super().__init__(memory, {name: place for place, name in enumerate(slot_names("sensors"))})
        seeds = (ctypes.c_uint64 * len(STREAMS))(*(derive_seed(rng_seed, "sensors", stream) for stream in STREAMS))
        library.sensors_start(self.address, seeds)

    def read(self, state: WorldState) -> Readings:
        """Read what is due at this step of the world; to be called once for every step."""
        _library().sensors_read(self.address, (ctypes.c_double * len(state))(*state))
        return Readings(*self.at[: len(Readings._fields)])

    def set_fault(self, name: str, size: float) -> None:
        """Put a fault of `FAULTS` on a sensor, or take it off by its healthy size; raises Refused for a bad one."""
        fault = FAULTS.get(name)
        if fault is None:
            raise Refused("sensor fault", expected=f"one of {', '.join(FAULTS)}", got=repr(name))
        if not fault.low <= size <= fault.high:
            raise Refused(f"sensor fault {name}", expected=f"{fault.low:g} to {fault.high:g} {fault.unit}", got=size)
        self[FAULT + name] = size
