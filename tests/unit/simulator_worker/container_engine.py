#!/usr/bin/env python3
"""A container engine for tests, by the command line alone: containers are folders, the one program in them a stand-in.

It holds Aerialist to what its documents say of a test file, and leaves a log of a straight flight. Environment:
STANDIN_WORDS is what it prints of its log ("" for nothing), STANDIN_HANGS=1 never ends, STANDIN_LINK is a file that
the log is a link to, STANDIN_ROOT holds containers.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "flight"))

ROOT = Path(os.environ["STANDIN_ROOT"])
IMAGE = "skhatiri/aerialist:2.0"


def place(container: str, path: str) -> Path:
    return ROOT / container / path.lstrip("/")


def there(container: str) -> None:
    if not (ROOT / container).is_dir():
        raise SystemExit(f"Error response from daemon: No such container: {container}")


def copy(source: str, target: str) -> None:
    if ":" in target:
        container, _, folder = target.partition(":")
        there(container)
        shutil.copy(source, place(container, folder))
    else:
        container, _, path = source.partition(":")
        there(container)
        if not place(container, path).is_file():
            raise SystemExit(f"Error response from daemon: Could not find the file {path} in container {container}")
        shutil.copy(place(container, path), target, follow_symlinks=False)  # as Docker does without -L


def execute(container: str, words: list[str]) -> int:
    there(container)
    assert words[:4] == ["python3", "aerialist", "exec", "--test"], words
    document: dict[str, Any] = yaml.safe_load(place(container, words[4]).read_text())
    assert set(document["robot"]) <= {"port", "params", "params_file", "mission_file"}
    assert place(container, document["robot"]["mission_file"]).is_file()
    known = {"simulator", "world", "speed", "headless", "obstacles", "home_position", "wind", "timeout"}
    assert set(document["simulation"]) <= known
    assert all(set(box) == {"size", "position"} for box in document["simulation"]["obstacles"])
    assert document["agent"]["engine"] == "local"
    if os.environ.get("STANDIN_HANGS"):
        signal.pause()
    if os.environ.get("STANDIN_LINK"):
        place(container, "/src/ros/log.ulg").symlink_to(os.environ["STANDIN_LINK"])
    place(container, "/src/ros/log.ulg").write_bytes(flight(document["simulation"]["timeout"]))
    print("a warning of something\n" + os.environ.get("STANDIN_WORDS", "LOG:/src/ros/log.ulg"), flush=True)
    return 0


def flight(limit_s: float) -> bytes:
    """A log: from the start 20 m straight east at 1 m/s and 5 m high, armed for 21 s; over 30 s, or the limit."""
    from log_bytes import ATTITUDE, POSITION, STATUS, ulog

    rows: list[tuple[str, float, tuple[float, ...]]] = []
    for tenth in range(round(10 * min(30.0, limit_s)) + 1):
        at = tenth / 10
        rows.append(("vehicle_local_position", at, (0.0, min(at, 20.0), -5.0, 0.0, float(at < 20), 0.0, True)))
        rows.append(("vehicle_attitude", at, (1.0, 0.0, 0.0, 0.0)))
    rows += [("vehicle_status", 0.0, (3, 2)), ("vehicle_status", 21.0, (4, 1))]
    topics = {"vehicle_local_position": POSITION, "vehicle_status": STATUS, "vehicle_attitude": ATTITUDE}
    return ulog(topics, [row for row in rows if row[1] <= limit_s])


def main(words: list[str]) -> int:
    if words[:2] == ["image", "inspect"]:
        if words[-1] != IMAGE:
            raise SystemExit(f"Error response from daemon: No such image: {words[-1]}")
        print("sha256:" + "ab" * 32)
    elif words[0] == "run":
        assert words[1:4] == ["--rm", "-d", "--name"], words
        assert words[5:7] == [IMAGE, "sleep"], words
        for folder in ("/src/aerialist/results", "/src/ros"):
            place(words[4], folder).mkdir(parents=True)
        print("0123456789ab")
    elif words[0] == "cp":
        copy(*words[1:])
    elif words[0] == "exec":
        return execute(words[1], words[2:])
    elif words[:2] == ["rm", "-f"]:
        shutil.rmtree(ROOT / words[2], ignore_errors=True)
    else:
        raise SystemExit(f"unknown command: {words}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
