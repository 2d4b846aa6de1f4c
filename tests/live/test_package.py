"""What is published: the source package builds a wheel that is whole and works where nothing of this checkout is."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.live
ROOT = Path(__file__).parents[2]


def ran(*words: str, cwd: Path, code: int = 0) -> str:
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source package, and the wheel built from it alone."""
    pytest.importorskip("build", reason="build is not installed: scripts/setup test,live")
    folder = tmp_path_factory.mktemp("dist")
    words = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder / "index"), "hatchling"]
    if subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("the package index does not answer")
    ran(sys.executable, "-m", "build", "--outdir", str(folder / "dist"), str(ROOT), cwd=folder)
    return folder / "dist"


def test_the_wheel_is_whole(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    assert "-py3-none-linux_" in wheel.name
    names = zipfile.ZipFile(wheel).namelist()
    inside = (
        "flight/native/_native.so",
        "flight/missions/",
        "oracle/policies/",
        "campaign/presets/",
        "console/templates/",
    )
    for part in inside:
        assert any(name.startswith(f"saflite/{part}") for name in names), part
    share = "/data/share/saflite-farm"
    for part in (
        "docs/own-policy.md",
        "examples/targets/point_mass.py",
        "schemas/campaign.schema.json",
        "foxglove-layout.json",
        "ci/",
    ):
        assert any(f"{share}/{part}" in name for name in names), part
    assert not [name for name in names if "/__pycache__/" in name or name.startswith(("tests/", "scripts/"))]


def test_both_packages_are_as_the_index_wants_them(built: Path) -> None:
    pytest.importorskip("twine", reason="twine is not installed: scripts/setup test,live")
    packages = sorted(str(path) for path in built.iterdir())
    assert len(packages) == 2
    ran(sys.executable, "-m", "twine", "check", "--strict", *packages, cwd=built)


def test_the_source_package_has_what_builds_and_tests_it(built: Path) -> None:
    (source,) = built.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"LICENSE", "README.md", "CHANGELOG.md", "scripts/build_native.py", "scripts/demo", "tests/conftest.py"}
    assert wanted <= names
    assert any(name.endswith(".c") and "/native/" in name for name in names)
    assert not [name for name in names if name.endswith(".so") or name.startswith((".venv", "runs/"))]


def test_the_wheel_runs_the_examples_it_brings_where_nothing_else_of_ours_is(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("*.whl")
    venv.create(tmp_path / "venv", with_pip=False)
    python = str(tmp_path / "venv" / "bin" / "python")
    ran(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", str(wheel), cwd=tmp_path)
    libraries = sysconfig.get_path("purelib")
    own = ran(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip()
    (Path(own) / "libraries.pth").write_text(libraries)
    saflite = str(tmp_path / "venv" / "bin" / "saflite")
    assert own in ran(python, "-c", "import saflite; print(saflite.__file__)", cwd=tmp_path)
    targets = tmp_path / "venv" / "share" / "saflite-farm" / "examples" / "targets"
    module = str(targets / "point_mass.py")
    ran(saflite, "conformance", "target", "point_mass", "--module", module, cwd=tmp_path)
    campaign = (str(targets / "point-mass.toml"), "--module", module, "--budget", "12", "--out", "run")
    ran(saflite, "run", *campaign, cwd=tmp_path, code=1)
    ran(saflite, "replay", "run", cwd=tmp_path, code=1)
    loaded = "from saflite.flight.native_library import native_library; native_library()"
    ran(python, "-c", loaded, cwd=tmp_path)
    advice = "from saflite.flight.mending import *; print(builds_library(), builds_firmware('gps').strip('`'))"
    said = ran(python, "-c", advice, cwd=tmp_path)
    assert "scripts/" not in said, "a wheel brings no scripts"
    _, _, module = said.rpartition(" -m ")
    ran(python, "-c", f"import {module.split()[0]}", cwd=tmp_path)
