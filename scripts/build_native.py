"""Compile every `native/*.c` under `services/saflite/flight` into one shared library, `flight/native/_native.so`.

Each folder `preload/` becomes a library of its own beside its sources, to be loaded into other programs.

Runs as the build hook of the wheel (also for editable installs) and by hand: `python scripts/build_native.py`.
The system's C compiler is used where there is one, the one in the `ziglang` package otherwise.
Contraction and host-specific instructions stay off: a trace must be bit-equal on every machine of a farm.
"""

from __future__ import annotations

import os
import runpy
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

FLAGS = [
    "-std=c11",
    "-O3",
    "-ffp-contract=off",
    "-fno-fast-math",
    "-fno-trapping-math",
    "-fno-math-errno",
    "-fPIC",
    "-shared",
    "-Wall",
    "-Wextra",
    "-Werror",
]
ROOT = Path(__file__).resolve().parent.parent
FLIGHT = ROOT / "services" / "saflite" / "flight"
NATIVE = FLIGHT / "native"


def compiler() -> list[str]:
    """Return the command of a C compiler: $CC, cc, or the one the `ziglang` package carries."""
    if os.environ.get("CC"):
        return os.environ["CC"].split()
    system = shutil.which("cc")
    return [system] if system else [sys.executable, "-m", "ziglang", "cc"]


def build() -> Path:
    """Compile all sources into `_native.so`; raises CalledProcessError with the compiler's own words."""
    native = runpy.run_path(str(FLIGHT / "native_sources.py"))
    sources = [str(path) for path in native["sources"]("c")]
    defined = [f"-I{NATIVE}", f'-DNATIVE_SOURCES="{native["digest"]()}"']
    return _link(NATIVE / "_native.so", [*defined, *sources, "-lm"])


def build_preloads() -> list[Path]:
    """Compile each `preload/` folder into `preload/_clock.so`; raises CalledProcessError as `build`."""
    folders = sorted({path.parent for path in FLIGHT.rglob("preload/*.c")})
    return [
        _link(folder / "_clock.so", ["-fvisibility=hidden", *map(str, sorted(folder.glob("*.c")))])
        for folder in folders
    ]


def _link(target: Path, arguments: list[str]) -> Path:
    partial = target.with_suffix(f".{os.getpid()}.tmp")
    subprocess.run([*compiler(), *FLAGS, "-o", str(partial), *arguments], check=True)
    partial.replace(target)
    return target


try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # run by hand, outside a build
    pass
else:

    class NativeHook(BuildHookInterface):  # type: ignore[misc]
        """Put the compiled library into the wheel and mark the wheel as one for this platform."""

        PLUGIN_NAME = "custom"

        def dependencies(self) -> list[str]:
            """Ask for the packaged compiler only where the system has none."""
            return [] if os.environ.get("CC") or shutil.which("cc") else ["ziglang"]

        def initialize(self, version: str, build_data: dict[str, Any]) -> None:
            """Compile before the wheel is packed."""
            for target in (build(), *build_preloads()):
                build_data["artifacts"].append(str(target.relative_to(ROOT)))
            build_data["pure_python"] = False
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data["tag"] = f"py3-none-{platform}"  # loaded by ctypes: any Python will do


if __name__ == "__main__":
    print(build(), *build_preloads())
