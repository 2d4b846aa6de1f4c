"""THE table of topics: key, message types, delivery class, who publishes, who reads.

Keys are `saflite/2/{campaign}/...`. Those of joining and of finding a farm hold no protocol number: `saflite/join/...`
and `saflite/farm/...`, so that who speaks another protocol is told so. Delivery classes:

    leased      query with a long poll; work is handed out under a lease
    committed   query answered only after the books have committed
    announced   advanced publisher, with history but for keys; the books can send it again from any sequence number
    alive       liveliness token, dropped when its session dies
    asked       query answered at once
    lossy       plain publication, may drop

All payloads are MessagePack but those of `event-json`, which are JSON by the same schema, published only while somebody
listens and without history. An order on `control/{verb}` may be given in JSON, too, and is then answered in JSON
(`AnswerJson`): `{"verb": "events", "number": 1}` on `control/events` asks for up to 1,000 events from the first on,
fewer where they are long.

A result may bring along the worker's next question for work (`Report.ask`): its receipt then answers both, without a
long poll.

A router lets no question through that is longer than its row says, nor anything longer than the longest.

Beside each message travels its seal, as Zenoh attachment: eight hexadecimal digits, the CRC-32 of key, a zero byte,
sender and payload, followed by the sender's name. The books refuse a question whose seal is missing or does not fit.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal, NamedTuple, get_args

import msgspec

from saflite.contract.blobs import CHUNK_BYTES_MAX, BlobChunk, BlobGet, BlobOpen, BlobOpened, BlobPut, BlobTaken
from saflite.contract.control import Answer, Control
from saflite.contract.errors import Refused
from saflite.contract.events import Event
from saflite.contract.join import Join, Joined
from saflite.contract.names import NAME_EXPECTED, is_name
from saflite.contract.wire import MESSAGE_BYTES_MAX
from saflite.contract.work import Ask, Grant, Heartbeat, Orders, Receipt, Report, Stage

PROTOCOL = 2
Delivery = Literal["leased", "committed", "announced", "alive", "asked", "lossy"]


class Topic(NamedTuple):
    """One row of the table. `answer` is None where nothing is answered; `bytes_max` bounds the message."""

    pattern: str
    message: type[msgspec.Struct] | None
    answer: type[msgspec.Struct] | None
    delivery: Delivery
    publisher: str
    readers: str
    root: str = ""
    bytes_max: int = MESSAGE_BYTES_MAX

    @property
    def key(self) -> str:
        """The whole key, with `{...}` for what varies."""
        return f"{self.root or f'saflite/{PROTOCOL}'}/{{campaign}}/{self.pattern}".rstrip("/")


SHORT_BYTES_MAX = 2**20
CHUNK_MESSAGE_BYTES_MAX = CHUNK_BYTES_MAX + 2**16
DIGESTS_BYTES_MAX = 8 * 2**20  # 100,000 of them

JOIN_ROOT, FARM_ROOT = "saflite/join", "saflite/farm"

TOPICS: tuple[Topic, ...] = (
    Topic("{stage}", Join, Joined, "asked", "workers", "books", JOIN_ROOT, SHORT_BYTES_MAX),
    Topic("", None, None, "alive", "books", "anyone", FARM_ROOT),
    Topic("work/{stage}", Ask, Grant, "leased", "workers", "books", bytes_max=SHORT_BYTES_MAX),
    Topic("result/{stage}", Report, Receipt, "committed", "workers", "books"),
    Topic("beat/{stage}", Heartbeat, Orders, "asked", "workers", "books", bytes_max=SHORT_BYTES_MAX),
    Topic("blob/open", BlobOpen, BlobOpened, "asked", "workers", "books", bytes_max=DIGESTS_BYTES_MAX),
    Topic("blob/get", BlobGet, BlobChunk, "asked", "workers", "books", bytes_max=SHORT_BYTES_MAX),
    Topic("blob/put", BlobPut, BlobTaken, "asked", "workers", "books", bytes_max=CHUNK_MESSAGE_BYTES_MAX),
    Topic("control/{verb}", Control, Answer, "asked", "console", "books", bytes_max=SHORT_BYTES_MAX),
    Topic("event/{kind}", Event, None, "announced", "books", "anyone"),
    Topic("event-json/{kind}", Event, None, "lossy", "books", "anyone"),
    Topic("alive/{stage}/{worker}/{session}", None, None, "alive", "workers", "books"),
)

STAGES: tuple[Stage, ...] = get_args(Stage)


def bytes_max(key: str) -> int:
    """Return how long a message on a key may be; that of the longest for one that stands in no row."""
    parts = key.split("/")
    return next((topic.bytes_max for topic in TOPICS if _fits(topic.key.split("/"), parts)), MESSAGE_BYTES_MAX)


def _fits(pattern: list[str], parts: list[str]) -> bool:
    return len(pattern) == len(parts) and all(
        wanted == got or wanted.startswith("{") for wanted, got in zip(pattern, parts, strict=True)
    )


@lru_cache(maxsize=16)
def prefix(campaign: str) -> str:
    """Return the key all topics of a campaign begin with; raises Refused for a name that keys and paths cannot hold."""
    return f"saflite/{PROTOCOL}/{_checked(campaign)}"


def _checked(campaign: str) -> str:
    if not is_name(campaign):
        raise Refused("campaign name", expected=NAME_EXPECTED, got=repr(campaign[:80]))
    return campaign


def join(campaign: str, stage: str) -> str:
    """Return the key on which workers of a stage join; `*` for all stages."""
    return f"{JOIN_ROOT}/{_checked(campaign)}/{stage}"


def farm(campaign: str) -> str:
    """Return the key of the liveliness token of a campaign's books."""
    return f"{FARM_ROOT}/{_checked(campaign)}"


def work(campaign: str, stage: Stage) -> str:
    """Return the key on which work of a stage is asked for."""
    return f"{prefix(campaign)}/work/{stage}"


def result(campaign: str, stage: Stage) -> str:
    """Return the key on which results of a stage are handed in."""
    return f"{prefix(campaign)}/result/{stage}"


def beat(campaign: str, stage: Stage) -> str:
    """Return the key on which workers of a stage send heartbeats."""
    return f"{prefix(campaign)}/beat/{stage}"


def blob(campaign: str, verb: Literal["open", "get", "put"]) -> str:
    """Return the key on which blobs are read and left in chunks."""
    return f"{prefix(campaign)}/blob/{verb}"


def control(campaign: str, verb: str) -> str:
    """Return the key on which an operator's order is given."""
    return f"{prefix(campaign)}/control/{verb}"


def event(campaign: str, kind: str) -> str:
    """Return the key on which facts of a kind are announced; `*` for all."""
    return f"{prefix(campaign)}/event/{kind}"


def event_json(campaign: str, kind: str) -> str:
    """Return the key on which facts of a kind are published in JSON while somebody listens; `*` for all."""
    return f"{prefix(campaign)}/event-json/{kind}"


def alive(campaign: str, stage: str, worker: str, session: str) -> str:
    """Return the key of the liveliness token of one life of a worker."""
    return f"{prefix(campaign)}/alive/{stage}/{worker}/{session}"
