"""@DESCRIPTION@"""

# It holds the messages of one recorded flight and the library that lets the firmware run in steps, and sends the same
# messages again: no world is simulated, nothing is installed, no port is opened, nothing outside a temporary folder
# is written. The firmware is unmodified; the library is preloaded and owns its clock, sleep, threads and sockets.

from __future__ import annotations

import argparse
import base64
import json
import lzma
import socket
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FACTS: dict[str, Any] = json.loads(r"""{"@FACTS@": 0}""")
SOURCES: dict[str, str] = json.loads(r"""{"@SOURCES@": ""}""")
RECORD = """@RECORD@"""

HEAD, STEP_S, PATIENCE_S = 212, 0.0025, 30.0
PILOT, TELEMETRY, TEST = range(3)
STATUS, BOX_IDS = 150, 119
COMPILER = ("gcc", "-std=c11", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")


def main() -> int:
    """Set the firmware up, replay the flight, tell what it did; 0 where the violation was seen, 1 where not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=Path, help="Betaflight built for its simulator target (make TARGET=SITL)")
    binary = parser.parse_args().binary.resolve()
    if not binary.is_file():
        parser.error(f"{binary} is no file")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        library = build_library(folder)
        configure(binary, library, folder)
        return replay(binary, library, folder)


def build_library(folder: Path) -> Path:
    """Compile the library that steps the firmware."""
    for name, text in SOURCES.items():
        path = folder / "source" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    library = folder / "clock.so"
    files = sorted(str(path) for path in (folder / "source").rglob("*.c"))
    try:
        subprocess.run([*COMPILER, "-o", str(library), *files], check=True)
    except (OSError, subprocess.CalledProcessError) as fault:
        sys.exit(f"gcc is needed, and does not compile here: {fault}")
    return library


class Firmware:
    """The firmware's process and the socket over which it is stepped."""

    def __init__(self, binary: Path, library: Path, folder: Path) -> None:
        self.link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.link.settimeout(PATIENCE_S)
        self.console = (folder / "console.txt").open("w+b")
        with theirs:
            variables = {"LD_PRELOAD": str(library), "SAFLITE_LINK": str(theirs.fileno()), **FACTS["variables"]}
            try:
                self.process = subprocess.Popen(
                    [str(binary)], cwd=folder, env=variables, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL,
                    stdout=self.console, stderr=self.console,
                )  # fmt: skip
            except OSError as fault:
                sys.exit(f"{binary} does not run here: {fault.strerror}")
        if not self.hear():  # its word that it has started
            sys.exit(f"{binary} does not start as a simulator build of Betaflight: {self.end()[-500:]!r}")

    def step(self, message: bytes) -> bytes:
        """Send one step and return the answer, empty where it died or hangs."""
        try:
            self.link.send(message)
        except OSError:
            return b""
        return self.hear()

    def hear(self) -> bytes:
        """Return one answer."""
        try:
            return self.link.recv(65_536)
        except OSError:
            return b""

    def end(self) -> str:
        """End it; return what it printed."""
        self.link.close()
        self.process.kill()
        self.process.wait()
        self.console.seek(0)
        with self.console:
            return self.console.read().decode("ascii", "replace")


def messages() -> list[bytes]:
    """Return the recorded messages: heads stored by byte position, then serial bytes."""
    data = lzma.decompress(base64.b64decode(RECORD))
    count = FACTS["steps"]
    heads = [data[index : count * HEAD : count] for index in range(count)]
    at, found = count * HEAD, []
    for head in heads:
        size = sum(struct.unpack_from("<3I", head, 200))
        found.append(head + data[at : at + size])
        at += size
    return found


def expected() -> list[int]:
    """Return the recorded checksums of answers."""
    data = lzma.decompress(base64.b64decode(RECORD))
    return list(struct.unpack(f"<{FACTS['steps']}I", data[-4 * FACTS["steps"] :]))


def said(answer: bytes, port: int) -> bytes:
    """Return what a serial port said in an answer, nothing where there was none."""
    if not answer:
        return b""
    sizes = struct.unpack_from("<3I", answer, 40)
    at = 52 + sum(sizes[:port])
    return answer[at : at + sizes[port]]


def configure(binary: Path, library: Path, folder: Path) -> None:
    """Give the settings by the firmware's own command line, and save."""
    if FACTS["eeprom"]:
        (folder / "eeprom.bin").write_bytes(lzma.decompress(base64.b64decode(FACTS["eeprom"])))
    firmware, quiet = Firmware(binary, library, folder), messages()[0][:200]

    def step(text: bytes = b"") -> bytes:
        return firmware.step(quiet + struct.pack("<3I", len(text), 0, 0) + text)

    def ask(text: bytes) -> str:
        heard = said(step(text), PILOT)
        for _ in range(8000):
            if heard.endswith(b"\r\n# "):
                return heard.decode("ascii", "replace")
            answer = step()
            if not answer:
                break
            heard += said(answer, PILOT)
        sys.exit(f"no prompt after {text!r}: {firmware.end()[-500:]}")

    for _ in range(200):
        step()
    ask(b"#")
    for line in FACTS["settings"]:
        if "###ERROR" in (heard := ask(line.encode() + b"\n")):
            sys.exit(f"a setting is not taken: {heard.strip()}")
    answer = step(b"save\n")
    while answer and struct.unpack_from("<I", answer)[0] == 1:
        answer = step()
    firmware.end()


def replay(binary: Path, library: Path, folder: Path) -> int:
    """Send all messages; tell how the firmware's states change, how it ends, and whether that is the violation."""
    firmware, wanted, states = Firmware(binary, library, folder), expected(), States(FACTS)
    equal, count, alive = 0, 0, True
    for message in messages():
        answer = firmware.step(message)
        equal += checksum(answer) == wanted[count]
        count += 1
        alive = bool(answer) and struct.unpack_from("<I", answer)[0] == 1
        if not alive:
            break
        changed = states.hear(answer, count)
        if changed:
            say(changed)
    console = firmware.end()
    say(f"\n{equal} of {FACTS['steps']} answers are those recorded, bit by bit")
    if FACTS["died"]:
        return died(alive, count, console)
    near = [row for row in states.rows if row[0] <= FACTS["until_s"]]
    same = near == [tuple(row) for row in FACTS["states"] if row[0] <= FACTS["until_s"]]
    say(f"the firmware's states up to the violation are {'those' if same else 'NOT those'} recorded")
    say(f"rule {FACTS['policy']}: {FACTS['title']}\nbroken from {FACTS['from_s']:g} s to {FACTS['until_s']:g} s")
    return tell(same)


def died(alive: bool, count: int, console: str) -> int:
    """Tell of a death."""
    say("\n".join(console.strip().splitlines()[-40:]))
    say(f"the firmware {'goes on' if alive else 'died'} after {count} of {FACTS['steps']} steps")
    return tell(not alive and count == FACTS["steps"])


def say(text: str) -> None:
    """Print a line."""
    sys.stdout.write(text + "\n")


def tell(seen: bool) -> int:
    """Say whether the violation was seen."""
    say("VIOLATION SEEN" if seen else "violation not seen")
    return 0 if seen else 1


def checksum(answer: bytes) -> int:
    """Return the checksum of an answer without the id of the process that gave it; 0 for none."""
    return zlib.crc32(answer[:8] + answer[12:]) or 1 if answer else 0


class States:
    """The firmware's own word on its state, from the answers on its serial ports."""

    def __init__(self, facts: dict[str, Any]) -> None:
        self.names = {int(box): name for box, name in facts["boxes"].items()}
        self.start_step = facts["start_step"]
        self.rows: list[tuple[float, str]] = []
        self.boxes: list[int] = []
        self.waiting = {TELEMETRY: b"", TEST: b""}

    def hear(self, answer: bytes, count: int) -> str:
        """Take the answer to the `count`-th message; return in words what changed."""
        time_s, known = round((count - self.start_step) * STEP_S, 4), len(self.rows)
        for port in (TELEMETRY, TEST):
            self.waiting[port] += said(answer, port)
            for command, payload in self.frames(port):
                if command == BOX_IDS and not self.boxes:
                    self.boxes = list(payload)
                if command == STATUS and time_s >= 0.0:
                    self.note(payload, time_s)
        return "\n".join(f"{at_s:9.3f} s  {words}" for at_s, words in self.rows[known:])

    def frames(self, port: int) -> Iterator[tuple[int, bytes]]:
        """Yield the whole answers that came in."""
        while (at := self.waiting[port].find(b"$M>")) >= 0 and len(self.waiting[port]) >= at + 6:
            data = self.waiting[port][at:]
            size = data[3]
            if len(data) < 6 + size:
                return
            self.waiting[port] = data[6 + size :]
            yield data[4], data[5 : 5 + size]

    def note(self, p: bytes, time_s: float) -> None:
        """Note a status, if it is another than the last."""
        extra = p[15] & 15
        bits = int.from_bytes(p[6:10] + p[16 : 16 + extra], "little")
        active = [self.names.get(box, f"box {box}") for place, box in enumerate(self.boxes) if bits >> place & 1]
        forbidden = int.from_bytes(p[17 + extra : 21 + extra], "little")
        words = f"{' '.join(active) or 'nothing active'}, arming flags {forbidden:#x}"
        if not self.rows or self.rows[-1][1] != words:
            self.rows.append((time_s, words))


if __name__ == "__main__":
    sys.exit(main())
