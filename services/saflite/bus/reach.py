"""How often to try to reach a router, and why it was not reached: Zenoh itself says no more than that time is up."""

from __future__ import annotations

import itertools
import socket
import ssl
from collections.abc import Iterator
from typing import NamedTuple

from saflite.bus.endpoints import Endpoint
from saflite.bus.keyring import CA, CERTIFICATE, KEY, Credentials
from saflite.contract.rng import derive_seed

TRY_FIRST_S, TRY_MAX_S = 2.0, 10.0
PAUSE_FIRST_S, PAUSE_MAX_S = 1.0, 30.0
PROBE_S = 2.0
OF_OTHERS = (7, 18, 19, 20, 21)  # _CERT_SIGNATURE_FAILURE, _SELF_SIGNED_CERT, _IN_CHAIN, no issuer known, no leaf
EXPIRED, NOT_ITS_NAME = 10, (62, 64)  # X509_V_ERR_CERT_HAS_EXPIRED, _HOSTNAME_MISMATCH and _IP_ADDRESS_MISMATCH


class Attempt(NamedTuple):
    """One attempt to reach a router: how long it may take, and how long to pause after it."""

    number: int
    try_s: float
    pause_s: float

    @property
    def worth_a_look(self) -> bool:
        """Whether to connect once more to see why it failed: another link given up half way, so seldom."""
        return self.number in (1, 4) or self.number % 16 == 0


def attempts(name: str, first_s: float) -> Iterator[Attempt]:
    """Yield attempts without end, each longer than the one before, with a pause after it that differs by name.

    A router that accepts TLS links waits 0.1 s after each that was given up half way (Zenoh's issue 2685): hundreds
    that come at once, give up after 2 s and come again shut each other out for ever.
    """
    for number in itertools.count(1):
        longer = 2 ** min(number - 1, 10)
        share = derive_seed(number, name) / 2**63
        yield Attempt(number, min(first_s * longer, TRY_MAX_S), share * min(PAUSE_FIRST_S * longer, PAUSE_MAX_S))


def why_unreached(endpoint: Endpoint, keys: Credentials | None) -> str:
    """Connect as Zenoh would and return what stands in the way; empty if nothing does."""
    if not endpoint.host:
        return ""
    try:
        with socket.create_connection((endpoint.host, endpoint.port), PROBE_S) as link:
            return _handshake(link, endpoint.host, keys) if keys is not None else ""
    except TimeoutError:
        return "nothing answers there"
    except OSError as fault:
        return fault.strerror or str(fault)


def _handshake(link: socket.socket, host: str, keys: Credentials) -> str:
    try:
        context = ssl.create_default_context(cafile=str(keys.folder / CA))
        context.load_cert_chain(keys.folder / CERTIFICATE, keys.folder / KEY)
        with context.wrap_socket(link, server_hostname=host) as secured:
            secured.settimeout(PROBE_S)
            secured.recv(1)  # with TLS 1.3 a refused certificate shows only now
    except ssl.SSLCertVerificationError as fault:
        return f"the router's certificate is not accepted: {fault.verify_message}{_mend(fault.verify_code, host)}"
    except ssl.SSLError as fault:
        return f"the router does not accept this certificate: {(fault.reason or str(fault)).replace('_', ' ').lower()}"
    except TimeoutError:  # the handshake went well, and nothing more is said to who does not speak Zenoh
        return ""
    return ""


def _mend(verify_code: int, host: str) -> str:
    if verify_code in OF_OTHERS:
        return "; it is of another farm than these keys: `saflite keys add`, where that farm's keys are, makes one"
    if verify_code == EXPIRED:
        return "; `saflite keys renew`, where the farm's keys are, makes a new one"
    if verify_code in NOT_ITS_NAME:
        return f"; `saflite keys renew --host {host}`, where the farm's keys are, makes one with that name"
    return ""
