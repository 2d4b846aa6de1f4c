"""`/metrics` of a farm in the OpenMetrics format: the campaign's status as last heard, read when Prometheus asks.

Everything is made from `contract.control.Status`, whose counts are exact; nothing is counted a second time here.
"""

from __future__ import annotations

import ipaddress
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any

from saflite.contract.clock import Clock
from saflite.contract.control import Status, WorkerStatus
from saflite.contract.errors import Refused, Unavailable, not_installed
from saflite.runtime.clock import WallClock
from saflite.runtime.metrics_server import BoundedServer

if TYPE_CHECKING:
    from prometheus_client.core import Metric

LOOPBACK = "127.0.0.1"
STALE_S = 10.0  # the books have not answered for so long: `saflite_up` is 0
MIB = 2**20
_LABEL = "[A-Za-z0-9-]{1,63}"
_ADDRESS = re.compile(rf"(?:(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<host>(?:{_LABEL}\.)*{_LABEL}\.?)):)?(?P<port>\d{{1,5}})")

_HOST = re.compile(r"(?P<host>\[[0-9A-Fa-f:.]+\]|[^:\[\]]+)(?::\d{1,5})?")


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of `[HOST:]PORT`; the loopback interface where no host is said. Raises Refused."""
    match = _ADDRESS.fullmatch(text)
    port = int(match["port"]) if match is not None else 0
    if match is None or not 1 <= port <= 65535 or (match["six"] and not _is_ip(match["six"])):
        raise Refused("--metrics", expected="PORT (on loopback) or HOST:PORT", got=repr(text[:80]))
    return match["six"] or match["host"] or LOOPBACK, port


def check_address(text: str) -> None:
    """Raise Refused or Unavailable where metrics could not be told, before anything is started."""
    with Endpoint(text, FarmMetrics(WallClock())):
        return


def _is_ip(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


class FarmMetrics:
    """What a farm's status says, as metrics. `update` is called by the one who follows the farm."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._latest: tuple[Status, float] | None = None

    def update(self, status: Status) -> None:
        """Take the latest status."""
        self._latest = status, self._clock.monotonic_s()

    def collect(self) -> Iterator[Metric]:
        """Yield every metric (Prometheus' collector protocol)."""
        latest = self._latest
        fresh = latest is not None and self._clock.monotonic_s() - latest[1] <= STALE_S
        yield _gauge("up", "1 while the books answer", {(): float(fresh)})
        if latest is not None:
            yield from _of_campaign(latest[0])
            yield from _of_workers(latest[0].workers)


class GroupMetrics:
    """How the roles of a group of workers are: their number by condition, and how often one was started again."""

    def __init__(self, look: Callable[[], tuple[Mapping[str, int], int]]) -> None:
        """`look` returns how many roles are in each condition, and the restarts so far."""
        self._look = look

    def collect(self) -> Iterator[Metric]:
        """Yield every metric (Prometheus' collector protocol)."""
        roles, restarts = self._look()
        yield _gauge("roles", "Roles of this group", {(name,): float(n) for name, n in roles.items()}, "condition")
        yield _counter("restarts", "Roles started again", {(): restarts})


def _of_campaign(status: Status) -> Iterator[Metric]:
    name = status.campaign
    info = {(name, status.state, status.scorer): 1.0}
    yield _gauge("campaign_state", "The campaign, its state and deciding scorer", info, "campaign", "state", "scorer")
    flights = {
        (name, "first"): status.flights,
        (name, "confirm"): status.reflown,
        (name, "check"): status.checked,
        (name, "shrink"): status.shrink_flights,
    }
    yield _counter("flights", "Flights flown, by purpose; only first ones count against the budget", flights, *_BY)
    violations = {
        (name, "confirmed"): status.violations_confirmed,
        (name, "similar"): status.violations_similar,
        (name, "flaky"): status.violations_flaky,
    }
    yield _counter("violations", "Violations decided upon", violations, "campaign", "confirmation")
    for metric, text, count in (
        ("test_cases", "Test cases chosen to be flown", status.test_cases),
        ("candidates", "Test cases proposed", status.candidates),
        ("behaviours", "Different ways to violate that were confirmed", status.behaviours),
        ("quarantined", "Test cases set aside after too many lost attempts", status.quarantined),
        ("unequal", "Flights flown over that did not repeat bit by bit", status.unequal),
        ("scorer_fallbacks", "Scores filled in by the embedded scorer", status.fallbacks - status.unscored),
        ("unscored", "Test cases that nobody scored", status.unscored),
        ("events", "Facts announced", status.seq),
        ("processor_seconds", "Processor time of books, workers and simulators in this sitting", status.processor_s),
    ):
        yield _counter(metric, text, {(name,): count}, "campaign")
    for metric, text, value in (
        ("budget_flights", "First flights the campaign may fly", status.budget),
        ("round", "Rounds planned", status.round),
        ("violations_pending", "Violations being confirmed", status.violations_pending),
        ("flights_per_second", "Flights over the last minute", status.flights_per_s),
        ("real_time_factor", "Simulated seconds per second over the last minute", status.real_time_factor),
        ("elapsed_seconds", "Time the books have been open", status.elapsed_s),
        ("trouble", "1 while something keeps the books from taking results", float(bool(status.trouble))),
        ("applied_ratio", "Share of verdicts in which a rule applied", status.exposure.applied_share),
    ):
        yield _gauge(metric, text, {(name,): value}, "campaign")
    queues = {(name, stage): float(count) for stage, count in status.queues.items()}
    yield _gauge("queue_tasks", "Tasks that wait or are lent out", queues, "campaign", "stage")


_BY = ("campaign", "purpose")
_WHO = ("worker", "stage", "host")


def _of_workers(workers: tuple[WorkerStatus, ...]) -> Iterator[Metric]:
    def each(value: Callable[[WorkerStatus], float]) -> dict[tuple[str, ...], float]:
        return {(one.worker, one.stage, one.host): value(one) for one in workers}

    yield _counter("worker_done", "Work done by a worker", each(lambda one: one.done), *_WHO)
    yield _gauge("worker_busy_ratio", "Share of its time a worker worked", each(lambda one: one.busy_share), *_WHO)
    yield _gauge("worker_leases", "Work lent to a worker", each(lambda one: one.leases), *_WHO)
    yield _gauge("worker_silent_seconds", "Since a worker was heard of last", each(lambda one: one.silent_s), *_WHO)
    memory = each(lambda one: one.resident_mib * MIB)
    yield _gauge("worker_resident_bytes", "Memory of a worker with its simulators", memory, *_WHO)


def _gauge(name: str, text: str, values: Mapping[Any, float], *labels: str) -> Metric:
    from prometheus_client.core import GaugeMetricFamily

    return _filled(GaugeMetricFamily(f"saflite_{name}", text, labels=labels), values)


def _counter(name: str, text: str, values: Mapping[Any, float], *labels: str) -> Metric:
    from prometheus_client.core import CounterMetricFamily

    return _filled(CounterMetricFamily(f"saflite_{name}", text, labels=labels), values)


def _filled(family: Any, values: Mapping[Any, float]) -> Metric:
    for labels, value in values.items():
        family.add_metric(labels, value)
    metric: Metric = family
    return metric


def _for_this_machine(app: Any) -> Any:
    """Return the WSGI application for those who ask for this machine by address or as `localhost`.

    A name of somebody else's that leads to loopback (DNS rebinding) would have a page of theirs read the answer.
    """

    def answer(asked: dict[str, Any], start: Any) -> Any:
        match = _HOST.fullmatch(asked.get("HTTP_HOST", ""))
        if match is not None and (match["host"].lower() == "localhost" or _is_ip(match["host"].strip("[]"))):
            return app(asked, start)
        start("403 Forbidden", [("Content-Type", "text/plain")])
        return [b"ask for 127.0.0.1 or localhost\n"]

    return answer


class Endpoint:
    """An HTTP server that answers `/metrics`; open it with `with`.

    Raises:
        Refused: no address.
        Unavailable: `prometheus-client` is not installed, or the address is in use or not of this machine.
    """

    def __init__(self, address: str, source: FarmMetrics | GroupMetrics) -> None:
        host, port = parse_address(address)
        try:
            from prometheus_client import CollectorRegistry, make_wsgi_app
        except ModuleNotFoundError as fault:
            raise not_installed("prometheus-client is", "metrics") from fault
        registry = CollectorRegistry(auto_describe=False)
        registry.register(source)
        app = make_wsgi_app(registry)
        if host == "localhost" or (_is_ip(host) and ipaddress.ip_address(host).is_loopback):
            app = _for_this_machine(app)
        try:
            self._server = BoundedServer(host, port)
        except OSError as fault:
            raise Unavailable(f"--metrics cannot listen on {host}:{port}: {fault}") from fault
        self._server.set_app(app)
        self._thread = threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True)
        self._thread.start()
        self.port = port

    def __enter__(self) -> Endpoint:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
