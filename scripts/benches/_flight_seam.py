"""What the seam between the world and an autopilot costs: steps in one native loop against one by one from Python."""

from __future__ import annotations

import ctypes
import runpy
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from saflite.flight.native_library import LIBRARY
from saflite.flight.sensors.sensors import Sensors
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.state import FLYING, STEP_S

HERE = Path(__file__).resolve().parent
ALTITUDE_M, HOVER = 100.0, 0.435
STEPS = round(20.0 / STEP_S)


@cache
def native_loop() -> ctypes.PyDLL:
    """Compile and load the native loop."""
    compiler = runpy.run_path(str(HERE.parent / "build_native.py"))["compiler"]()
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "hover.so"
        words = ("-std=c11", "-O3", "-fPIC", "-shared", f"-I{LIBRARY.parent}", "-o", str(built))
        subprocess.run([*compiler, *words, str(HERE / "_hover.c"), str(LIBRARY)], check=True)
        library = ctypes.PyDLL(str(built))
    library.hover.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_int]
    return library


def fused() -> tuple[float, float]:
    """Hover with world and sensors in one native loop."""
    return _hover(lambda world, sensors: native_loop().hover(world.address, sensors.address, HOVER, STEPS))


def apart() -> tuple[float, float]:
    """Hover with every step asked for from Python, as a bridge to another process would."""

    def step(world: World, sensors: Sensors) -> None:
        for _ in range(STEPS):
            sensors.read(world.step((HOVER,) * 4))

    return _hover(step)


def _hover(run: Callable[[World, Sensors], object]) -> tuple[float, float]:
    world, sensors = World(ALTITUDE_M), Sensors(1)
    run(world, sensors)
    assert world.state.world_state == FLYING, "it did not stay in the air"
    assert world.state.step == STEPS
    return STEPS * STEP_S, STEPS * STEP_S
