"""Makes the script that reproduces a finding without the farm: the flight is flown once more and written down."""

from __future__ import annotations

import base64
import json
import lzma
import struct
import tempfile
from pathlib import Path
from typing import Any

from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, FlightRecord, trace_digest
from saflite.contract.standalone import Evidence, as_docstring, filled
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.betaflight import user_memory
from saflite.flight.autopilots.betaflight.configuration import Memory, configure, lines
from saflite.flight.autopilots.betaflight.firmware import CLOCK_LIBRARY, Variant, digest, listing
from saflite.flight.autopilots.betaflight.flight import BetaflightFlight
from saflite.flight.autopilots.betaflight.inputs import configured
from saflite.flight.autopilots.betaflight.process import SANITIZER_OPTIONS
from saflite.flight.autopilots.betaflight.standalone import replay_script
from saflite.flight.autopilots.betaflight.standalone.link_record import DOWN_HEAD, LinkRecord, Tap
from saflite.flight.autopilots.betaflight.switches import SWITCHES

_MAKE = "make TARGET=SITL"
_HEADER = """Reproduces a finding on Betaflight without the farm that found it: {title}

{asked}
Steps (seconds after the start state: {start}):
{steps}

What it needs: Linux (x86-64), Python 3.9 or later and nothing beside its standard library, gcc, and the firmware:
  {version}
  built by `{make}` from that version's source{options}.
  Recorded with the binary of SHA-256 {digest}.

  python3 {name} obj/main/betaflight_SITL.elf

What it does: it gives the settings by the firmware's command line, then replays what the firmware was sent in one
recorded flight, step by step of 2.5 ms, and tells what the firmware makes of it. With the same binary every answer is
the same bit by bit. A binary built elsewhere may answer with other motor values; what is sent does not react to that,
so the longer the flight, the less such a replay says. Exit code 0: the violation was seen; 1: it was not."""


def standalone(test_case: TestCase, flight: Flight, evidence: Evidence, variant: Variant) -> str:
    """Return the text of the script.

    Raises:
        Refused: the flight is not repeated by the binary that is here.
        Unavailable: JSBSim or the firmware does not come up.
    """
    case = configured(test_case, variant).test_case
    base = user_memory.read(case.target.settings)
    record, start_step, flown = _recorded(case, variant)
    _check_same(flight, flown)
    died = flown.ending == "autopilot_died"
    facts: dict[str, Any] = {
        "eeprom": base64.b64encode(lzma.compress(base)).decode() if base else "",
        "settings": lines(variant, case.target.parameters),
        "variables": {"ASAN_OPTIONS": SANITIZER_OPTIONS} if variant.sanitized else {},
        "boxes": {str(switch.box): name for name, switch in SWITCHES.items()},
        "steps": len(record.messages),
        "start_step": start_step,
        "died": died,
        "policy": evidence.policy,
        "title": evidence.title,
        "from_s": evidence.from_s,
        "until_s": evidence.until_s,
    }
    states = replay_script.States(facts)
    for count, answer in enumerate(record.answers, start=1):
        if answer:
            states.hear(answer, count)
    facts["states"] = states.rows
    return _filled(_described(case, evidence, variant), facts, record)


def _recorded(case: TestCase, variant: Variant) -> tuple[LinkRecord, int, FlightRecord]:
    """Fly from power-up; return what passed over the link, the step of the start state, and the flight."""
    with tempfile.TemporaryDirectory() as place:
        folder, tap = Path(place), Tap(Path(place) / "link")
        flight = BetaflightFlight(case, variant, _memory(case, variant, folder), folder)
        flight.launch = tap.start
        flown = flight.run(lambda: False)
        return tap.read(), flight.start_step, flown


def _memory(case: TestCase, variant: Variant, folder: Path) -> Memory:
    return configure(variant, case.target.parameters, folder, user_memory.read(case.target.settings))


def _check_same(flight: Flight, flown: FlightRecord) -> None:
    digest_here = "" if flown.trace is None else trace_digest(flown.trace)
    if (flight.ending, flight.trace_digest) != (flown.ending, digest_here):
        raise Refused(
            f"flight of {flight.test_case}",
            expected=f"{flight.ending}, trace {flight.trace_digest[:16]}",
            got=f"{flown.ending}, trace {digest_here[:16]}",
            fix="export it with the binary and the software that the run was made with",
        )


def _described(case: TestCase, evidence: Evidence, variant: Variant) -> str:
    start = case.scenario.start
    return _HEADER.format(
        title=evidence.title,
        asked="".join(f"{what}: {answer}\n" for what, answer in evidence.asked.items()),
        start="hovering in ANGLE" if start is None else f"{start.mode}, {start.altitude_m:g} m",
        steps="\n".join(f"  {step}" for step in evidence.steps),
        version=listing(variant).version,
        make=f'{_MAKE} OPTIONS="{variant.options}"' if variant.options else _MAKE,
        options=" with address and undefined-behaviour sanitizers" if variant.sanitized else "",
        digest=digest(variant.binary),
        name=evidence.file,
    )


def _filled(description: str, facts: dict[str, Any], record: LinkRecord) -> str:
    """Return the script with what it holds put in its places."""
    folder = CLOCK_LIBRARY.parent
    files = [*sorted(folder.glob("*.[ch]")), folder.parent / "native" / "link.h"]
    sources = {str(path.relative_to(folder.parent)): path.read_text(encoding="utf-8") for path in files}
    text = Path(replay_script.__file__).read_text(encoding="utf-8")
    packed = base64.encodebytes(lzma.compress(_packed(record), preset=6)).decode()
    contents = {
        "@DESCRIPTION@": as_docstring(description),
        '{"@FACTS@": 0}': json.dumps(facts, indent=1),
        '{"@SOURCES@": ""}': json.dumps(sources, indent=1),
        "@RECORD@": packed,
    }
    return filled(text, contents)


def _packed(record: LinkRecord) -> bytes:
    """Return heads byte position by byte position (what changes little lies together), serial bytes, checksums."""
    heads = b"".join(message[:DOWN_HEAD] for message in record.messages)
    by_place = b"".join(heads[place::DOWN_HEAD] for place in range(DOWN_HEAD))
    serial = b"".join(message[DOWN_HEAD:] for message in record.messages)
    sums = [replay_script.checksum(answer) for answer in record.answers]
    return by_place + serial + struct.pack(f"<{len(sums)}I", *sums)
