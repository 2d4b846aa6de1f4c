"""Which model servers may be sent a key.

The address of a server may come over the bus, from whoever may order another scorer. So a key is sent only where the
user's own settings name the host: the default server of its kind, or `SAFLITE_KEY_HOSTS` (comma-separated
`host[:port]`, or `https://host[:port]`). A farm adds the hosts its campaign file names, in the environment of its
scorers: never over the bus.
"""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import urlsplit

from saflite.contract.config import ScorerConfig, environment
from saflite.scorer_pool.labels import split_label

KEY_HOSTS = "SAFLITE_KEY_HOSTS"
_PORTS = {"http": 80, "https": 443}


def host_of(url: str) -> str:
    """Return `host:port` of an address, empty if it has none; an address without a scheme counts as http."""
    try:
        parts = urlsplit(url if "://" in url else f"http://{url}")
        port = parts.port or _PORTS.get(parts.scheme, 0)
    except ValueError:
        return ""
    return f"{parts.hostname}:{port}" if parts.hostname else ""


def origin_of(url: str) -> str:
    """Return `scheme://host:port` of an address as `host_of` reads it, empty if it has none."""
    host = host_of(url)
    return f"{urlsplit(url).scheme if '://' in url else 'http'}://{host}" if host else ""


def may_have_key(url: str, default_url: str) -> bool:
    """Return whether a key may be sent to `url`: it is the user's default server or one of `SAFLITE_KEY_HOSTS`.

    Never unencrypted to one that was named with https, or that has its port.
    """
    named = [part.strip() for part in environment(KEY_HOSTS).split(",") if part.strip()]
    trusted = {origin_of(default_url), *(origin_of(name) for name in named)}
    trusted |= {origin_of(f"https://{name}") for name in named if "://" not in name}
    origin = origin_of(url)
    return origin in trusted - {""} and not (origin.startswith("http:") and origin.endswith(":443"))


def hosts_named_by(scorer: ScorerConfig) -> tuple[str, ...]:
    """Return where the model servers are that a campaign names in labels such as `openai:MODEL@URL`.

    As `SAFLITE_KEY_HOSTS` has them: `host:port`, with `https://` before it where the campaign says so.
    """
    urls = (split_label(label)[1].partition("@") for label in (scorer.model, *scorer.shadow))
    named = ((origin_of(url), host_of(url)) for _, at, url in urls if at)
    return tuple(dict.fromkeys(origin if origin.startswith("https:") else host for origin, host in named if host))


def with_key_hosts(hosts: Sequence[str]) -> dict[str, str]:
    """Return what to set in the environment of a scorer so that it may send keys to `hosts`, too."""
    named = [part for part in (environment(KEY_HOSTS), *hosts) if part]
    return {KEY_HOSTS: ",".join(named)} if named else {}
