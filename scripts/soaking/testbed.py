"""Where a soak takes place: a run folder on a small disk, a network that can be cut, the farm, and who watches it."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

from saflite.bus.endpoints import free_endpoint
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.contract.config import Campaign, LeaseConfig, ScorerConfig, SearchConfig, StrategyConfig
from saflite.contract.control import Status
from saflite.contract.errors import FarmError
from saflite.contract.events import Event
from saflite.contract.test_case import Target
from saflite.contract.work import Stage
from saflite.runtime.client import FarmClient
from saflite.runtime.clock import WallClock
from saflite.runtime.farm import LocalFarm
from saflite.runtime.launchers.base import RoleSpec
from saflite.simulator_worker.registry import describe_target

MARK = "SAFLITE_SOAK"
DISK = "256m"
TARGET_FILE = Path(__file__).parent / "soak.py"
HOST_IP, GUEST_IP = "10.213.77.1", "10.213.77.2"
FAR_FLYER = "fly-2"  # the worker in the namespace
OUTSIDE, INSIDE, SPACE = "saflite-soak0", "saflite-soak1", "saflite-soak"


def campaign(rng_seed: int, fault_share: float) -> Campaign:
    """Return a campaign of short flights, some of which crash or hang their simulator."""
    return Campaign(
        name="soak",
        mission="mission1",
        time_limit_s=150.0,
        target=Target(name="soak", parameters={"SOAK_SHARE": fault_share}),
        budget_flights=1_000_000,
        rng_seed=rng_seed,
        strategy=StrategyConfig(name="random_boxes"),
        scorer=ScorerConfig(model="gap", batch=2, deadline_s=5.0),
        search=SearchConfig(candidates_per_round=16, flights_per_round=8, lag=2, confirm_flights=1),
        lease=LeaseConfig(lease_s=2.0, heartbeat_s=0.4, wall_limit_s=6.0),
        record="violations",
    )


class Disk:
    """A folder on a small disk of its own where that is allowed, else an ordinary one (`why_not` says why)."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="saflite-soak-"))
        mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(self.folder)]
        allowed = os.geteuid() == 0 and shutil.which("mount") is not None
        done = subprocess.run(mount, capture_output=True, check=False) if allowed else None
        self.is_small = done is not None and done.returncode == 0
        self.why_not = "" if self.is_small else "needs the right to mount a tmpfs"

    def fill(self) -> None:
        """Leave no byte free."""
        with suppress(OSError), (self.folder / "ballast").open("ab", buffering=0) as ballast:
            while ballast.write(b"\0" * 65536):
                pass

    def free(self) -> None:
        """Give the space back."""
        (self.folder / "ballast").unlink(missing_ok=True)

    def remove(self) -> None:
        """Unmount and delete."""
        if self.is_small:
            subprocess.run(["umount", "-l", str(self.folder)], check=False)
        shutil.rmtree(self.folder, ignore_errors=True)


class Network:
    """A network namespace joined to this one by a cable that can be pulled; where allowed (`why_not`)."""

    def __init__(self) -> None:
        self.why_not = "" if os.geteuid() == 0 else "needs root for network namespaces"
        self.why_not = self.why_not or ("" if shutil.which("ip") else "needs the program `ip`")
        if self.why_not:
            return
        self.remove()
        commands = [
            f"ip netns add {SPACE}",
            f"ip link add {OUTSIDE} type veth peer name {INSIDE}",
            f"ip link set {INSIDE} netns {SPACE}",
            f"ip addr add {HOST_IP}/30 dev {OUTSIDE}",
            f"ip link set {OUTSIDE} up",
            f"ip netns exec {SPACE} ip addr add {GUEST_IP}/30 dev {INSIDE}",
            f"ip netns exec {SPACE} ip link set {INSIDE} up",
            f"ip netns exec {SPACE} ip link set lo up",
        ]
        for command in commands:
            done = subprocess.run(command.split(), capture_output=True, check=False)
            if done.returncode != 0:
                self.why_not = f"`{command}` failed: {done.stderr.decode().strip()}"
                self.remove()
                return

    @property
    def prefix(self) -> tuple[str, ...]:
        """What puts a command inside."""
        return () if self.why_not else ("ip", "netns", "exec", SPACE)

    def cut(self) -> None:
        """Pull the cable; packets vanish without a word."""
        subprocess.run(["ip", "link", "set", OUTSIDE, "down"], check=False)

    def join(self) -> None:
        """Put the cable back."""
        subprocess.run(["ip", "link", "set", OUTSIDE, "up"], check=False)

    def remove(self) -> None:
        """Take the namespace away."""
        if shutil.which("ip") is None or os.geteuid() != 0:
            return
        for command in (f"ip link del {OUTSIDE}", f"ip netns del {SPACE}"):
            subprocess.run(command.split(), capture_output=True, check=False)


class Watcher(threading.Thread):
    """Follows every event as a person's tool does; notes when each came, and any gap or double."""

    def __init__(self, endpoint: str, name: str) -> None:
        super().__init__(daemon=True)
        self._endpoint, self._campaign, self._clock = endpoint, name, WallClock()
        self.events: list[tuple[float, Event]] = []
        self.trouble = ""

    def run(self) -> None:
        """Watch until the campaign has ended."""
        try:
            client = FarmClient.connect(self._endpoint, self._campaign, patience_s=None, insecure=True)
            for event in client.watch(1, patience_s=300.0):
                self.events.append((self._clock.monotonic_s(), event))
            client.close()
        except FarmError as fault:
            self.trouble = str(fault)

    def is_gapless(self) -> bool:
        """Return whether the numbers ran 1, 2, 3, ..."""
        return [event.seq for _, event in self.events] == list(range(1, len(self.events) + 1))


class Prober(threading.Thread):
    """Asks the books for the status ten times a second; notes for how long they did not answer."""

    def __init__(self, endpoint: str, name: str) -> None:
        super().__init__(daemon=True)
        self._endpoint, self._campaign, self._clock = endpoint, name, WallClock()
        self.answers_s: list[float] = []
        self.last: Status | None = None
        self.is_over = False

    def run(self) -> None:
        """Probe until told to end."""
        client = FarmClient.connect(self._endpoint, self._campaign, patience_s=None, insecure=True)
        while not self.is_over:
            try:
                self.last = client.status(within_s=0.1)
            except FarmError:
                continue
            self.answers_s.append(self._clock.monotonic_s())
            self._clock.sleep_s(0.1)
        client.close()


class Testbed:
    """All of it. `close` leaves nothing behind."""

    def __init__(self, rng_seed: int, fault_share: float) -> None:
        os.environ[MARK] = str(os.getpid())
        self.clock = WallClock()
        self.disk, self.network = Disk(), Network()
        self.run_dir = self.disk.folder / "run"
        self.campaign = campaign(rng_seed, fault_share)
        Store.create(
            self.run_dir, self.campaign, template(self.campaign), describe_target("soak", [TARGET_FILE])
        ).close()
        port = free_endpoint().rpartition(":")[2]
        self.endpoint = f"tcp/{'127.0.0.1' if self.network.why_not else HOST_IP}:{port}"
        stages: tuple[Stage, ...] = ("mutate", "score", "judge", "record", "fly")
        workers = [RoleSpec(kind=stage, name=f"{stage}-1") for stage in stages]
        router = RoleSpec(kind="router", name="router", listens=True)
        cast = [router, RoleSpec(kind="books", name="books"), *workers, RoleSpec(kind="fly", name=FAR_FLYER)]
        self.farm = LocalFarm(
            "soak",
            self.run_dir,
            cast,
            modules=[TARGET_FILE],
            listen=self.endpoint,
            insecure=True,
            prefix_of=lambda spec: self.network.prefix if spec.name == FAR_FLYER else (),
        )
        self.watcher = Watcher(self.endpoint, "soak")
        self.prober = Prober(self.endpoint, "soak")

    def start(self) -> None:
        """Start the farm and those who watch it."""
        self.farm.start()
        self.watcher.start()
        self.prober.start()

    def stop(self) -> list[str]:
        """Stop the farm; return the command lines of processes it left behind."""
        self.prober.is_over = True
        self.prober.join(5)
        self.farm.stop()
        return orphans()

    def close(self) -> None:
        """Remove the network and the disk."""
        self.network.remove()
        self.disk.remove()


def orphans() -> list[str]:
    """Return the command lines of processes that carry this soak's mark, this process excepted."""
    mark = f"{MARK}={os.getpid()}".encode()
    found: list[str] = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit() or int(folder.name) == os.getpid():
            continue
        with suppress(OSError):
            if mark in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode())
    return found
