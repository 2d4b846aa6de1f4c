"""Which endpoints are told apart: what only this user reaches, what others do, what is none."""

from __future__ import annotations

import pytest

from saflite.bus.endpoints import check_endpoint, parse_endpoint
from saflite.contract.errors import Refused


def test_a_unix_socket_needs_nothing() -> None:
    text = "unixsock-stream//run/farm"
    assert check_endpoint(text, insecure=False).text == text


@pytest.mark.parametrize(
    "text",
    ["tcp/10.0.0.5:7447", "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/[fe80::1]:7447", "tcp/books.example:7447",
     "tcp/127.0.0.1:7447", "tcp/127.9.9.9:1", "tcp/[::1]:7447", "tcp/localhost:7447"],
)  # fmt: skip
def test_what_others_reach_needs_insecure(text: str) -> None:
    with pytest.raises(Refused, match="--insecure") as caught:
        check_endpoint(text, insecure=False, argument="--listen")
    assert "\n" not in str(caught.value)
    assert check_endpoint(text, insecure=True).text == text


@pytest.mark.parametrize(
    "text",
    ["", "tcp", "tcp/", "tcp/127.0.0.1", "tcp/127.0.0.1:0", "tcp/127.0.0.1:65536", "udp/127.0.0.1:7447",
     "tcp/[nonsense]:7447", "tcp/127.0.0.1:7447#iface=eth0", "tcp/a b:1", "unixsock-stream/",
     "tcp/127.0.0.1:7447;tcp/10.0.0.5:7447", "unixsock-stream//" + "x" * 200,
     "tcp/" + "h" * 64 + ":1", "tcp/a..b:1", "tcp/" + "h." * 130 + "h:1"],
)  # fmt: skip
def test_what_is_no_endpoint_is_refused_even_if_insecure(text: str) -> None:
    with pytest.raises(Refused):
        check_endpoint(text, insecure=True)


@pytest.mark.parametrize(
    ("listen", "here"),
    [
        ("tcp/0.0.0.0:7447", "tcp/127.0.0.1:7447"),
        ("tcp/[::]:7447", "tcp/[::1]:7447"),
        ("tcp/10.0.0.5:7447", "tcp/10.0.0.5:7447"),
    ],
)
def test_a_router_on_all_addresses_is_reached_over_loopback(listen: str, here: str) -> None:
    assert parse_endpoint(listen).from_here == here
