"""Who the served dashboard lets in without tokens, asked over real sockets."""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import other_user
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "console"))

from dashboard_runs import make_run

pytestmark = pytest.mark.live

ASK = """
import http.client, json, sys
port, method, path, body, headers = json.loads(sys.argv[1])
asked = http.client.HTTPConnection("127.0.0.1", port)
asked.request(method, path, body, headers)
print(asked.getresponse().status)
"""
FORWARDED = ("X-Forwarded-For", "X-Real-IP", "Forwarded")


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The port of a dashboard over a run."""
    run = make_run(tmp_path_factory.mktemp("served") / "run", 2)
    command = [sys.executable, "-m", "saflite", "dashboard", str(run), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield int(process.stdout.readline().split()[1].rstrip("/").rpartition(":")[2])
    finally:
        process.terminate()
        process.wait(20)


def _claims(port: int) -> list[dict[str, str]]:
    """Return headers that claim another place to ask from: one of ours (the dashboard's own), and one of nobody."""
    places = (f"127.0.0.1:{port}", "127.0.0.1", f"[::1]:{port}", "192.0.2.1:1")
    claims = [{name: f"for={place}" if name == "Forwarded" else place} for name in FORWARDED for place in places]
    return [{}, *claims]


def test_no_header_says_whose_socket_asks(port: int) -> None:
    for claim in _claims(port):
        asked = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        asked.request("GET", "/run/0/", headers=claim)
        assert asked.getresponse().status == 200, claim
        asked.close()


def test_another_user_is_let_in_by_no_header(port: int) -> None:
    stranger = other_user.prefix()
    order = ("POST", "/run/0/order", '{"verb":"stop"}')
    for method, path, body in (("GET", "/run/0/", None), ("GET", "/assets/style.css", None), order):
        for claim in _claims(port):
            words = json.dumps([port, method, path, body, {"X-Saflite": "1", **claim}])
            command = [*stranger, other_user.PYTHON, "-c", ASK, words]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            assert done.stdout.strip() == "403", (path, claim)
