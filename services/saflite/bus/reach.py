"""Why a router was not reached, in words: Zenoh itself says no more than that time is up."""

from __future__ import annotations

import socket
import ssl

from saflite.bus.endpoints import Endpoint
from saflite.bus.keyring import CA, CERTIFICATE, KEY, Credentials

PROBE_S = 2.0


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
        return f"the router's certificate is not accepted: {fault.verify_message}"
    except ssl.SSLError as fault:
        return f"the router does not accept this certificate: {(fault.reason or str(fault)).replace('_', ' ').lower()}"
    except TimeoutError:  # the handshake went well, and nothing more is said to who does not speak Zenoh
        return ""
    return ""
