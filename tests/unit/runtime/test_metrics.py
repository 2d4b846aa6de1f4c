"""Metrics are what the status says, in a form that Prometheus' own parser of OpenMetrics reads."""

from __future__ import annotations

import http.client
import socket
import threading
import time
from contextlib import ExitStack

import msgspec
import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.exposition import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from saflite.contract.clock import Clock
from saflite.contract.control import Status, WorkerStatus
from saflite.contract.errors import Refused
from saflite.runtime.metrics import STALE_S, Endpoint, FarmMetrics, GroupMetrics, parse_address
from saflite.runtime.metrics_server import CONNECTIONS_MAX

WORKER = WorkerStatus(worker="lab-fly-1", stage="fly", state="busy", leases=2, done=7, busy_share=0.5, silent_s=1.5)
STATUS = Status(
    campaign="night",
    state="running",
    round=3,
    budget=100,
    flights=41,
    reflown=6,
    test_cases=44,
    candidates=120,
    violations_confirmed=2,
    violations_flaky=1,
    violations_pending=3,
    quarantined=0,
    flights_per_s=1.25,
    real_time_factor=300.0,
    since_last_find_s=None,
    elapsed_s=60.0,
    scorer='blend "x"\n',
    scorer_pending="",
    fallbacks=4,
    queues={"fly": 5, "judge": 0},
    workers=(WORKER,),
    seq=99,
)


class Still(Clock):
    now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return self.now_s

    def sleep_s(self, duration_s: float) -> None:
        self.now_s += duration_s


def _read(source: FarmMetrics | GroupMetrics) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(source)
    text = generate_latest(registry).decode()  # type: ignore[no-untyped-call]
    families = text_string_to_metric_families(text)  # type: ignore[no-untyped-call]
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in families
        for sample in family.samples
    }


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def test_a_status_is_told_whole() -> None:
    metrics = FarmMetrics(Still())
    metrics.update(STATUS)
    told = _read(metrics)
    night, who = ("campaign", "night"), (("host", ""), ("stage", "fly"), ("worker", "lab-fly-1"))
    assert told["saflite_up", ()] == 1.0
    assert told["saflite_flights_total", (night, ("purpose", "first"))] == 41
    assert told["saflite_flights_total", (night, ("purpose", "confirm"))] == 6
    assert told["saflite_violations_total", (night, ("confirmation", "confirmed"))] == 2
    assert told["saflite_queue_tasks", (night, ("stage", "fly"))] == 5
    assert told["saflite_worker_done_total", who] == 7
    assert told["saflite_worker_busy_ratio", who] == 0.5
    assert told["saflite_trouble", (night,)] == 0
    assert told["saflite_campaign_state", (night, ("scorer", 'blend "x"\n'), ("state", "running"))] == 1


def test_trouble_and_silence_show() -> None:
    clock = Still()
    metrics = FarmMetrics(clock)
    assert _read(metrics) == {("saflite_up", ()): 0.0}
    metrics.update(msgspec.structs.replace(STATUS, trouble="the disk is full"))
    assert _read(metrics)["saflite_trouble", (("campaign", "night"),)] == 1
    clock.now_s = STALE_S + 1
    assert _read(metrics)["saflite_up", ()] == 0.0


def test_a_group_tells_its_roles() -> None:
    told = _read(GroupMetrics(lambda: ({"running": 3, "waiting": 1}, 2)))
    assert told["saflite_roles", (("condition", "running"),)] == 3
    assert told["saflite_restarts_total", ()] == 2


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("9464", ("127.0.0.1", 9464)),
        ("0.0.0.0:9464", ("0.0.0.0", 9464)),
        ("[::1]:1", ("::1", 1)),
        ("lab.example:80", ("lab.example", 80)),
    ],
)
def test_metrics_stay_on_loopback_unless_told_otherwise(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize("text", ["", "0", "65536", "x", ":9464", "[zz]:9", "http://a:1", "-1", "1:2:3"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(Refused, match="--metrics"):
        parse_address(text)


@pytest.mark.parametrize(
    ("name", "status"),
    [
        *((name, 200) for name in ("localhost", "LOCALHOST:1", "127.0.0.1:9464", "[::1]:9464", "[::1]")),
        *((name, 403) for name in ("evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "a:b:c")),
    ],
)
def test_on_loopback_no_page_of_another_site_reads_them_by_a_name_of_its_own(name: str, status: int) -> None:
    port = _free_port()
    with Endpoint(str(port), FarmMetrics(Still())):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
        connection.putrequest("GET", "/metrics", skip_host=True)
        connection.putheader("Host", name)
        connection.endheaders()
        answer = connection.getresponse()
        assert (answer.status, b"saflite_up" in answer.read()) == (status, status == 200)
        connection.close()


def test_connections_that_ask_nothing_cost_the_farm_no_more_than_so_many_threads() -> None:
    port, before = _free_port(), set(threading.enumerate())
    with Endpoint(str(port), FarmMetrics(Still())), ExitStack() as held:
        silent = [held.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(5 * CONNECTIONS_MAX)]
        for one in silent[: 4 * CONNECTIONS_MAX]:
            one.settimeout(60.0)
            assert one.recv(1) == b"", "it was ended for those that came later"
        deadline_s = time.monotonic() + 60.0
        while len(left := set(threading.enumerate()) - before) > CONNECTIONS_MAX + 2:
            assert time.monotonic() < deadline_s, "those whose connection was ended end"
            left.pop().join(0.05)
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60.0)
        connection.request("GET", "/metrics")
        assert b"saflite_up" in connection.getresponse().read()
        connection.close()
