"""Events to a web server: one POST an event, in order, again until it is taken, from where an earlier bridge stopped.

Delivery is at least once: an event whose answer was lost is sent again, under the same id. Signatures follow Standard
Webhooks (standardwebhooks.com): HMAC-SHA256 over id, time and body, so that a receiver can tell who sends, and refuse
what is old.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import logging
import os
import queue
import re
import threading
from http.cookiejar import CookieJar, DefaultCookiePolicy
from pathlib import Path
from typing import Annotated, Protocol

import httpx
import msgspec

from saflite.contract import wire
from saflite.contract.bounds import Place, Seconds, Word
from saflite.contract.clock import Clock
from saflite.contract.cloud_event import CONTENT_TYPE, CloudEvent, cloud_event
from saflite.contract.errors import Refused
from saflite.contract.events import Event
from saflite.contract.names import Name
from saflite.contract.outside import TEXT_BYTES_MAX, read_bytes
from saflite.evidence.files import write_whole

log = logging.getLogger(__name__)

ANSWER_S = 10.0
CONNECT_S = 2.0  # more than a silent receiver's own timeout, whose words are better
RETRY_FIRST_S, RETRY_MAX_S = 0.5, 60.0
AGAIN = frozenset({408, 425, 429})  # of 4xx: the receiver is busy; any other says that it will never take this
SECRET_PREFIX = "whsec_"  # noqa: S105 (how Standard Webhooks writes a secret)
SECRET_BYTES_MIN = 16
SECRET_BYTES_MAX = 4096
PORT_MAX = 65_535


Kinds = Annotated[tuple[Word, ...], msgspec.Meta(max_length=1_000)]

_HOST = re.compile(rb"[A-Za-z0-9._-]+|\[?[0-9A-Fa-f:.]+\]?")  # as httpx has it: encoded


class WaitingClock(Clock, Protocol):
    """A clock that can be waited by."""

    def sleep_s(self, duration_s: float) -> None:
        """Wait."""
        ...


class Cursor(msgspec.Struct, frozen=True, kw_only=True):
    """How far a bridge is: the run, when it began, and the last event that was taken, `told_as` what.

    Up to there all events of `kinds` were taken, all there are if it names none; whether others were nobody knows.
    `end` is the last event there is, once the campaign has ended and all are here; 0 before.
    """

    campaign: Name
    begun_unix_s: Seconds
    seq: Place = 0
    told_as: Word = ""
    kinds: Kinds = ()
    end: Place = 0

    def covers(self, kinds: frozenset[str]) -> bool:
        """Whether all events of these kinds (of all, if empty) were taken up to there."""
        return not self.kinds or (bool(kinds) and kinds <= frozenset(self.kinds))


def read_cursor(path: Path) -> Cursor | None:
    """Return where an earlier bridge stopped, None if there was none; raises Refused for a file that is not one."""
    if not os.path.lexists(path):
        return None
    try:
        return wire.unpack_json(read_bytes(path, "--cursor", TEXT_BYTES_MAX), Cursor)
    except wire.UNREADABLE as fault:
        raise Refused("--cursor", where=str(path), expected="one an earlier bridge wrote", got=str(fault)) from fault


def keep_cursor(path: Path, cursor: Cursor) -> None:
    """Write how far the bridge is, whole or not at all; raises Unavailable if the disk fails."""
    write_whole(path, msgspec.json.encode(cursor))


def read_secret(path: Path) -> bytes:
    """Return the secret in a file, `whsec_` and Base64 or plain text.

    Raises:
        Refused: others can read the file, or it holds none, or one too short to be any.
    """
    try:
        text = read_bytes(path, "--secret", SECRET_BYTES_MAX, private=True).decode("ascii").strip()
        plain = not text.startswith(SECRET_PREFIX)
        secret = text.encode() if plain else base64.b64decode(text.removeprefix(SECRET_PREFIX), validate=True)
    except (UnicodeDecodeError, binascii.Error) as fault:
        raise Refused("--secret", where=str(path), expected="a file with a secret", got=str(fault)) from fault
    if len(secret) < SECRET_BYTES_MIN:
        expected = f"at least {SECRET_BYTES_MIN} bytes"
        raise Refused("--secret", where=str(path), expected=expected, got=f"{len(secret)}")
    return secret


def check_url(url: str) -> str:
    """Return the URL; raises Refused, without saying it (it may hold secrets), unless it is one of a web server."""
    wrong = Refused("--webhook", expected="http(s)://HOST/PATH", got="something else")
    try:
        parsed = httpx.URL(url)
        parsed.host.encode("idna")  # as client and resolver do, at each POST
    except (httpx.InvalidURL, UnicodeError) as fault:
        raise wrong from fault
    is_host = _HOST.fullmatch(parsed.raw_host) is not None and 0 <= (parsed.port or 0) <= PORT_MAX
    if parsed.scheme not in ("http", "https") or not is_host:
        raise wrong
    return url


def shown_url(url: str) -> str:
    """Return a URL as it may stand in messages and logs: without password, path and query, which may hold secrets."""
    parsed = httpx.URL(url)
    return f"{parsed.scheme}://{parsed.netloc.decode('ascii')}/..."


def headers_of(event: CloudEvent, body: bytes, now_unix_s: float, secret: bytes) -> dict[str, str]:
    """Return the headers of a POST, signed if there is a secret."""
    sent_s = str(int(now_unix_s))
    headers = {"content-type": CONTENT_TYPE, "webhook-id": event.id, "webhook-timestamp": sent_s}
    if secret:
        signed = b".".join((event.id.encode(), sent_s.encode(), body))
        digest = hmac.new(secret, signed, hashlib.sha256).digest()
        headers["webhook-signature"] = f"v1,{base64.b64encode(digest).decode()}"
    return headers


class Webhook:
    """A receiver at a URL. Redirects are not followed, cookies not kept."""

    def __init__(
        self, url: str, clock: WaitingClock, secret: bytes = b"", transport: httpx.BaseTransport | None = None
    ):
        self._url, self._clock, self._secret, self._transport = check_url(url), clock, secret, transport
        self._client = self._connected()

    def deliver(self, event: Event, cursor: Cursor) -> None:
        """Send one event of the cursor's run, until it is taken.

        Raises:
            Refused: the receiver says that it will not take it, whenever it is sent.
        """
        told = cloud_event(event, cursor.campaign, f"{cursor.campaign}-{cursor.begun_unix_s:.0f}")
        body = wire.encode_json(told)
        wait_s = RETRY_FIRST_S
        while True:
            why = self._sent(told, body)
            if not why:
                return
            log.warning("event %d not taken, tried again in %.1f s: %s", event.seq, wait_s, why)
            self._clock.sleep_s(wait_s)
            wait_s = min(2 * wait_s, RETRY_MAX_S)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def _connected(self) -> httpx.Client:
        none = CookieJar(
            DefaultCookiePolicy(allowed_domains=())
        )  # they would be kept, and sent with each event, for good
        hooks = {"response": [_stay]}
        return httpx.Client(
            timeout=ANSWER_S, transport=self._transport, trust_env=False, cookies=none, event_hooks=hooks
        )

    def _sent(self, event: CloudEvent, body: bytes) -> str:
        """Return why the event was not taken, empty if it was."""
        code = self._answer(body, headers_of(event, body, self._clock.unix_s(), self._secret))
        if isinstance(code, str):
            return code
        if 200 <= code < 300:
            return ""
        if code < 500 and code not in AGAIN:
            words = f"HTTP {code} for event {event.data.seq}"
            raise Refused("--webhook", where=shown_url(self._url), expected="a receiver that takes events", got=words)
        return f"HTTP {code}"

    def _answer(self, body: bytes, headers: dict[str, str]) -> int | str:
        """Return the code of the answer, or in words why there is none.

        The client's timeout is for each piece it reads: interim answers, or a byte now and then, would hold it for
        ever. So the whole of it has a limit: it runs in a thread, whose connection is closed when that is over.
        """
        client, answers = self._client, queue.SimpleQueue[int | str]()
        threading.Thread(target=_post, args=(client, self._url, body, headers, answers), daemon=True).start()
        try:
            return answers.get(timeout=ANSWER_S + CONNECT_S)
        except queue.Empty:
            self._client = self._connected()
            client.close()
            return f"no whole answer within {ANSWER_S + CONNECT_S:.0f} s"


def _stay(answer: httpx.Response) -> None:
    """Forget where an answer leads: the client reads that though it follows none, and breaks over what it cannot."""
    answer.headers.pop("location", None)


def _post(
    client: httpx.Client, url: str, body: bytes, headers: dict[str, str], answers: queue.SimpleQueue[int | str]
) -> None:
    said: int | str = "asking broke"
    try:
        with client.stream("POST", url, content=body, headers=headers) as answer:
            said = answer.status_code  # what it says besides is not read
    except (httpx.HTTPError, OSError, RuntimeError) as fault:  # the latter two: of a client that was closed meanwhile
        said = f"{type(fault).__name__}: {fault}"
    finally:
        answers.put(said)
