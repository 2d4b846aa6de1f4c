"""A flight is bit-equal whether the processor has wide registers or not."""

from __future__ import annotations

import ctypes
import runpy
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from saflite.contract.test_case import Obstacle
from saflite.flight import native_library, native_sources
from saflite.flight.geometry import boxes_array
from saflite.flight.planner import kinematic, native
from saflite.flight.planner.kinematic import KinematicFlight, fly_kinematic

pytestmark = pytest.mark.live
MISSION = np.array([(0, 0, 10), (0, 45, 10), (10, 20, 10), (0, 5, 10)], dtype=np.float64)
LAYOUT = (
    Obstacle(length_m=9, width_m=5, height_m=18, x_m=1, y_m=24, rotation_deg=20),
    Obstacle(length_m=5, width_m=12, height_m=14, x_m=11, y_m=30, rotation_deg=75),
)


def narrow(folder: Path) -> ctypes.CDLL:
    """Return the library compiled without its second, wider copy of the hot functions."""
    builder = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "build_native.py"))
    target = folder / "narrow.so"
    sources = [str(path) for path in native_sources.sources("c")]
    defined = [f"-I{builder['NATIVE']}", f'-DNATIVE_SOURCES="{native_sources.digest()}"', "-DEXACT_NARROW"]
    subprocess.run(
        [*builder["compiler"](), *builder["FLAGS"], "-o", str(target), *defined, *sources, "-lm"], check=True
    )
    return ctypes.CDLL(str(target))


def flown() -> list[KinematicFlight]:
    boxes = boxes_array(LAYOUT)
    return [fly_kinematic(MISSION, boxes, rng_seed=seed) for seed in range(5)]


def test_wide_registers_change_no_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("cc") is None or b"avx2" not in Path("/proc/cpuinfo").read_bytes():
        pytest.skip("needs gcc and a processor with AVX2: without them there is one copy only")
    assert b"histogram_build.avx2" in native_library.LIBRARY.read_bytes()
    wide = flown()
    plain = narrow(tmp_path)
    monkeypatch.setattr(native, "native_library", lambda: plain)
    native.library.cache_clear()
    kinematic._state.cache_clear()
    try:
        slow = flown()
    finally:
        monkeypatch.undo()
        native.library.cache_clear()
    for one, other in zip(wide, slow, strict=True):
        assert one.track.tobytes() == other.track.tobytes()
        assert one.clearance_m == other.clearance_m
