"""Pods find their keys as the keyring wants them: their first step is done on a Secret as Kubernetes mounts it."""

from __future__ import annotations

import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from saflite.bus import keyring
from saflite.contract.errors import Refused

FARM = Path(__file__).resolve().parents[2] / "deploy" / "kubernetes" / "farm.yaml"
MODES = [0o644, 0o640, 0o440]
"""What the files of a Secret may come as: by default, and with a group of the pod's own, which may always read."""


def _pod(name: str) -> Any:
    found = [one for one in yaml.safe_load_all(FARM.read_text()) if one["metadata"]["name"] == name]
    return next(one["spec"]["template"]["spec"] for one in found if "template" in one.get("spec", {}))


def _farm_file() -> str:
    found = (one["data"]["farm.toml"] for one in yaml.safe_load_all(FARM.read_text()) if one["kind"] == "ConfigMap")
    return str(next(found))


def _mount(secret: Any, keys: dict[str, Path], folder: Path, mode: int) -> None:
    """Lay a Secret's files out as Kubernetes does: links to a folder of the day."""
    items = {one["path"]: keys[one["key"]] for one in secret["items"]} if "items" in secret else keys
    for path, source in items.items():
        file = folder / "..2026" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(source.read_bytes())
        file.chmod(mode)
    (folder / "..data").symlink_to("..2026")
    for top in {Path(path).parts[0] for path in items}:
        (folder / top).symlink_to(f"..data/{top}")


def _started(pod: Any, keys: dict[str, Path], place: Path, mode: int) -> Path:
    """Do the first step of a pod; returns the folder that its container finds keys in, by what it is told."""
    (first,), (box,) = pod["initContainers"], pod["containers"]
    volumes = {one["name"]: one for one in pod["volumes"]}
    command = "\n".join(first["command"][2:])
    assert first["command"][:2] == ["sh", "-ec"]
    assert "securityContext" not in first, "the files would be somebody else's"
    for mount in first["volumeMounts"]:
        here = place / mount["name"]
        here.mkdir()
        here.chmod(0o777)  # as the kubelet makes a folder in memory
        command = command.replace(mount["mountPath"], str(here))
        if "secret" in volumes[mount["name"]]:
            _mount(volumes[mount["name"]]["secret"], keys, here, mode)
    subprocess.run(["sh", "-ec", command], check=True, umask=0o022)
    (given,) = [one for one in first["volumeMounts"] if "emptyDir" in volumes[one["name"]]]
    assert volumes[given["name"]]["emptyDir"] == {"medium": "Memory"}, "keys would lie on the node's disk"
    mounts = {one["name"]: one["mountPath"] for one in box["volumeMounts"]}
    assert mounts[given["name"]] == given["mountPath"]
    assert not [name for name in mounts if "secret" in volumes.get(name, {})]
    (told,) = re.findall(re.escape(given["mountPath"]) + r"/[a-z]+", f"{box['args']} {_farm_file()}")[:1]
    return place / str(given["name"]) / Path(told).name


@pytest.mark.parametrize("mode", MODES, ids=oct)
@pytest.mark.parametrize("name", ["saflite-farm", "saflite-fly"])
def test_a_pod_has_keys_that_the_keyring_takes(name: str, mode: int, tmp_path: Path) -> None:
    now_s, made = time.time(), tmp_path / "made"
    keyring.init(made, ["saflite-farm"], now_s=now_s)
    keyring.add(made, "simulators", ["worker"], now_s=now_s)
    read: dict[str, Callable[[Path, float], object]] = {
        "saflite-farm": keyring.farm_credentials,
        "saflite-fly": keyring.peer_credentials,
    }
    sources = {
        "saflite-farm": [made / "register.toml", *(made / "farm").iterdir()],
        "saflite-fly": [*(made / "peers" / "simulators").iterdir()],
    }
    secret = {path.name: path for path in sources[name]}
    pod = _pod(name)
    given = _started(pod, secret, tmp_path, mode)
    assert read[name](given, now_s)
    for file in given.rglob("*.pem"):
        file.chmod(mode)
    with pytest.raises(Refused, match="others can read"):
        read[name](given, now_s)


def test_a_restarted_pod_leaves_the_modes_of_its_run_folder_alone() -> None:
    """Kubernetes would let the pod's group write in all of a volume at each start; a farm refuses such a folder."""
    pod = _pod("saflite-farm")
    assert pod["securityContext"]["fsGroupChangePolicy"] == "OnRootMismatch"
