"""The checks of `saflite doctor`, each on its own, none raising: a finding says what was seen and how to mend it."""

from __future__ import annotations

import os
import platform
import shutil
import sqlite3
import sys
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import msgspec

from saflite.contract.bounds import ITEMS_MAX, Word
from saflite.contract.errors import FarmError, Refused, Unavailable, pip_install
from saflite.contract.plain import some

if TYPE_CHECKING:
    from saflite.flight.autopilots.external.binary import Binaries

DISK_FREE_MIN_GIB = 1.0
DEFAULT_OLLAMA = "http://127.0.0.1:11434"
ANSWER_S = 2.0


class Finding(NamedTuple):
    """One line of the doctor. `note`: missing, but the farm runs without it."""

    what: str
    state: Literal["ok", "note", "bad"]
    text: str


class _Model(msgspec.Struct, frozen=True):
    name: Word


class _Models(msgspec.Struct, frozen=True):
    """What a server of models lists."""

    models: Annotated[tuple[_Model, ...], msgspec.Meta(max_length=ITEMS_MAX)] = ()


Check = Callable[[], Finding]


def all_checks(folder: Path, ollama: str) -> list[Check]:
    """Return the checks in the order in which things are needed."""
    from saflite.simulator_worker.registry import target_names

    return [
        _python,
        _packages,
        _machine,
        _native,
        _jsbsim,
        _bus,
        partial(_store, folder),
        partial(_disk, folder),
        _policies,
        _flight,
        _ardupilot,
        _ardupilot_parameters,
        _px4,
        _px4_parameters,
        _own_network,
        *(partial(_target, name) for name in target_names()),
        partial(_ollama, ollama),
    ]


def _python() -> Finding:
    good = sys.version_info >= (3, 11)
    text = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Finding("python", "ok" if good else "bad", text if good else f"{text}; 3.11 or newer is needed")


def _packages() -> Finding:
    missing, found = [], 0
    try:
        wanted = [text for text in requires("saflite-farm") or () if "extra ==" not in text]
    except PackageNotFoundError:
        wanted = ["eclipse-zenoh", "jsbsim", "mcap", "msgspec", "numpy", "rich", "scikit-learn", "pymavlink", "pyulog"]
    for text in wanted:
        name = text.split(";")[0].split("[")[0]
        for mark in "<>=!~ ":
            name = name.split(mark)[0]
        try:
            version(name)
            found += 1
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return Finding("packages", "bad", f"missing {', '.join(missing)}; run `{pip_install(*missing)}`")
    return Finding("packages", "ok", f"{found} installed")


def _machine() -> Finding:
    cores = len(os.sched_getaffinity(0))
    memory_gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return Finding("machine", "ok", f"{cores} cores (one simulator each by default), {memory_gib:.1f} GiB memory")


def _native() -> Finding:
    from saflite.flight.native_library import LIBRARY, native_library

    try:
        native_library()
    except Unavailable as fault:
        return Finding("compiled code", "bad", str(fault))
    return Finding("compiled code", "ok", f"{LIBRARY.stat().st_size // 1024} KiB")


def _jsbsim() -> Finding:
    try:
        import jsbsim
    except ImportError as fault:
        return Finding("JSBSim", "bad", f"{fault}; run `{pip_install('jsbsim')}`")
    aircraft = Path(jsbsim.get_default_root_dir()) / "aircraft" / "F450"
    if not aircraft.exists():
        return Finding("JSBSim", "bad", f"no F450 in {aircraft.parent}; install jsbsim 1.3 or newer")
    return Finding("JSBSim", "ok", f"{version('jsbsim')} with the F450")


def _bus() -> Finding:
    from saflite.console.doctor.bus_check import round_trip

    try:
        return Finding("bus", "ok", f"Zenoh {version('eclipse-zenoh')}, asked and answered in {round_trip():.1f} ms")
    except (FarmError, OSError, ImportError, RuntimeError) as fault:
        return Finding("bus", "bad", f"{fault}; is loopback networking allowed here?")


def _store(folder: Path) -> Finding:
    path = folder / f".saflite-doctor-{os.getpid()}.sqlite"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with sqlite3.connect(path) as store:
            mode = store.execute("pragma journal_mode=wal").fetchone()[0]
            store.execute("create table probe (number integer)")
        store.close()
    except (sqlite3.Error, OSError) as fault:
        return Finding("store", "bad", f"SQLite cannot write to {folder.resolve()}: {fault}")
    finally:
        for leftover in folder.glob(f"{path.name}*"):
            leftover.unlink()
    if mode != "wal":
        return Finding("store", "bad", f"the file system of {folder.resolve()} cannot do write-ahead logging")
    return Finding("store", "ok", f"SQLite {sqlite3.sqlite_version}, write-ahead log works")


def _disk(folder: Path) -> Finding:
    free_gib = shutil.disk_usage(folder).free / 2**30
    good = free_gib >= DISK_FREE_MIN_GIB
    return Finding("disk", "ok" if good else "bad", f"{free_gib:.1f} GiB free" + ("" if good else "; 1 GiB is needed"))


def _policies() -> Finding:
    from saflite.oracle.policy import load_policy, policy_names

    broken = []
    for name in policy_names():
        try:
            load_policy(name)
        except Refused as fault:
            broken.append(str(fault))
    if broken:
        return Finding("policies", "bad", broken[0])
    return Finding("policies", "ok", f"{len(policy_names())} load, each agrees with its examples")


def _flight() -> Finding:
    from saflite.campaign.presets.campaigns import load_campaign, template
    from saflite.console.operations import judging

    try:
        flown = judging.fly(template(load_campaign("avoidance-m2")), 120.0)
    except (FarmError, OSError) as fault:
        return Finding("flight", "bad", str(fault))
    flight = flown.flight
    if flight.ending != "completed":
        return Finding("flight", "bad", f"mission 2 without obstacles ended as {flight.ending}: {flight.message}")
    speed = flight.simulated_s / max(flight.wall_s, 1e-9)
    return Finding("flight", "ok", f"mission 2 in {flight.wall_s:.1f} s, {speed:.0f}x real time with start-up")


def _target(name: str) -> Finding:
    from saflite.console.doctor.target_check import target_words

    what = f"target {name}"
    try:
        sound, text = target_words(name)
    except Unavailable as fault:
        return Finding(what, "note", f"cannot fly here: {fault}")
    except Refused as fault:
        return Finding(what, "bad", str(fault))
    return Finding(what, "ok" if sound else "bad", text)


def _ollama(url: str) -> Finding:
    import asyncio

    import httpx

    from saflite.contract import wire
    from saflite.contract.config import environment

    place = url or environment("OLLAMA_HOST") or DEFAULT_OLLAMA
    place = place if "://" in place else f"http://{place}"
    try:
        listed = wire.unpack_json(asyncio.run(_answer(f"{place}/api/tags")), _Models)
    except (httpx.HTTPError, httpx.InvalidURL, TimeoutError, ValueError, *wire.UNREADABLE) as fault:  # a host of no IDN
        return Finding("model server", "note", f"none at {place} ({type(fault).__name__}); embedded scorers need none")
    names = some(sorted(model.name for model in listed.models)) or "no models yet"
    return Finding("model server", "ok", f"{place}: {names}")


async def _answer(url: str) -> bytes:
    """Return what a server answers, as scorers ask it: a bounded time, a bounded size, past no proxy."""
    import asyncio

    import httpx

    from saflite.scorer_pool.llm.http import BoundedTransport

    async with asyncio.timeout(ANSWER_S), httpx.AsyncClient(transport=BoundedTransport()) as client:
        return (await client.get(url)).content


def _ardupilot() -> Finding:
    from saflite.flight.autopilots.ardupilot.binary import BINARIES

    def told() -> str:
        binary = BINARIES.named()
        return f"{binary.version}, digest {binary.digest[:12]}, with the JSON backend"

    return _named("ArduPilot", told)


def _ardupilot_parameters() -> Finding:
    from saflite.flight.autopilots.ardupilot.binary import BINARIES
    from saflite.simulator_worker.targets.ardupilot import parameters_known

    return _starts(BINARIES, parameters_known)


def _px4() -> Finding:
    from saflite.flight.autopilots.px4.binary import BINARIES

    backend = "with the simulator's MAVLink interface and its files"
    return _named("PX4", lambda: f"digest {BINARIES.named().digest[:12]}, {backend}")


def _px4_parameters() -> Finding:
    from saflite.flight.autopilots.px4.binary import BINARIES
    from saflite.simulator_worker.targets.px4 import parameters_known

    return _starts(BINARIES, parameters_known)


def _own_network() -> Finding:
    from saflite.simulator_worker import own_network

    if own_network.may_enter():
        return Finding("own network", "ok", "nobody else of this machine reaches the ports of ArduPilot and PX4")
    text = "this user may make none: who reaches this machine can steer flights of ArduPilot and PX4"
    return Finding("own network", "note", f"{text}; allow user namespaces, or keep to a machine of your own")


def _named(autopilot: str, told: Callable[[], str]) -> Finding:
    try:
        return Finding(autopilot, "ok", told())
    except Unavailable as fault:
        return Finding(autopilot, "note", f"{fault}; the other targets need none")
    except Refused as fault:
        return Finding(autopilot, "bad", str(fault))


def _starts(binaries: Binaries, known: Callable[[], tuple[int, int]]) -> Finding:
    what = f"{binaries.label} starts"
    try:
        binaries.named()
    except Unavailable as fault:
        return Finding(what, "note", f"not tried: {fault}")
    except Refused as fault:
        return Finding(what, "bad", str(fault))
    try:
        count, documented = known()
    except FarmError as fault:  # a person who names a binary wants it to fly
        return Finding(what, "bad", str(fault))
    return Finding(what, "ok", f"in lockstep, answers over MAVLink: {count} parameters, {documented} with ranges")
