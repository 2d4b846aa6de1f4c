"""The container engine's command line: an image, a container of it for one flight, files in and out.

Docker's words, which Podman takes, too: `image inspect`, `run`, `cp`, `exec`, `rm`.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from saflite.contract.clock import Clock
from saflite.contract.config import environment
from saflite.contract.errors import Unavailable
from saflite.contract.service import Cancelled

IMAGE_VARIABLE, ENGINE_VARIABLE = "SAFLITE_AERIALIST", "SAFLITE_CONTAINER_ENGINE"
IMAGE = "skhatiri/aerialist:2.0"  # what Aerialist's own template.env names
ANSWER_S = 60.0  # to start a container or copy a file
LOOK_S = 10.0  # to say what images there are
POLL_S = 0.2
OUTPUT_BYTES_MAX = 2**20


class Image(NamedTuple):
    """An image that is here, and the engine's program; `digest` is the image's own identity."""

    program: str
    name: str
    digest: str

    def run(self, container: str, lives_s: float) -> None:
        """Start a container that ends by itself after `lives_s`; one of that name goes first."""
        self.remove(container)
        self._asked("run", "--rm", "-d", "--name", container, self.name, "sleep", f"{lives_s:.0f}")

    def copy_in(self, path: Path, container: str, folder: str) -> None:
        """Copy a file into a folder of the container."""
        self._asked("cp", str(path), f"{container}:{folder}")

    def copy_out(self, container: str, path: str, to: Path) -> None:
        """Copy a file of the container to a place here."""
        self._asked("cp", f"{container}:{path}", str(to))

    def remove(self, container: str) -> None:
        """End a container and all that runs in it; none of that name is fine."""
        _answer([self.program, "rm", "-f", container])

    def execute(
        self, container: str, command: Sequence[str], console: Path, clock: Clock, late_s: float, cancelled: Cancelled
    ) -> int | None:
        """Run a command in the container, what it prints going to `console`; its exit code, None where it was late.

        Raises Unavailable where it was cancelled.
        """
        with console.open("wb") as sink:
            process = subprocess.Popen(
                [self.program, "exec", container, *command], stdin=subprocess.DEVNULL, stdout=sink, stderr=sink
            )
            try:
                while clock.monotonic_s() < late_s:
                    if cancelled():
                        raise Unavailable("the flight was cancelled")
                    try:
                        return process.wait(POLL_S)
                    except subprocess.TimeoutExpired:
                        continue
                return None
            finally:
                process.kill()  # the engine's client; what it started ends with the container
                process.wait()

    def _asked(self, *words: str) -> str:
        done = _answer([self.program, *words])
        if done is None or done.returncode:
            said = "no answer" if done is None else _last_line(done.stderr) or f"exit code {done.returncode}"
            raise Unavailable(f"{self.program} {words[0]}: {said}")
        return done.stdout.strip()


def named_image() -> Image:
    """Return the image that flies here; raises Unavailable with what to do where there is no engine or no image."""
    program = environment(ENGINE_VARIABLE, "docker")
    if shutil.which(program) is None:
        raise Unavailable(f"no {program} on the path; install a container engine or name one: {ENGINE_VARIABLE}=podman")
    name = environment(IMAGE_VARIABLE) or IMAGE
    done = _answer([program, "image", "inspect", "--format", "{{.Id}}", name], LOOK_S)
    if done is None:
        raise Unavailable(f"{program} gave no answer within {LOOK_S:.0f} s")
    if done.returncode or not done.stdout.strip():
        fix = f"`{program} pull {name}`, or name another: {IMAGE_VARIABLE}=IMAGE"
        raise Unavailable(f"no image {name} ({_last_line(done.stderr) or 'not found'}); {fix}")
    return Image(program, name, done.stdout.strip())


def _answer(command: Sequence[str], within_s: float = ANSWER_S) -> subprocess.CompletedProcess[str] | None:
    """Return what a command of the engine came to, None where it did not end in time or could not be run."""
    try:
        return subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=within_s,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:300] if lines else ""
