"""An event as others outside the farm are told it over HTTP: CloudEvents 1.0, JSON format (cloudevents.io)."""

from __future__ import annotations

import msgspec

from saflite.contract import wire
from saflite.contract.bounds import Word
from saflite.contract.clock import in_utc
from saflite.contract.events import Event, kind_of
from saflite.contract.ids import digest

CONTENT_TYPE = "application/cloudevents+json"


class CloudEvent(msgspec.Struct, frozen=True, kw_only=True):
    """One event. `id` and `source` together are its own for ever; `sequence` sorts as text (extension "sequence").

    Where commits were lost, their numbers are given again: so the `id` tells the content, too.
    """

    specversion: str = "1.0"
    id: Word
    source: Word
    type: Word
    time: Word
    sequence: Word
    datacontenttype: str = "application/json"
    data: Event


def told_as(event: Event) -> str:
    """Return what tells an event from another of the same number: the beginning of the digest of its bytes."""
    return digest(wire.encode(event))[:8]


def cloud_event(event: Event, campaign: str, run: str) -> CloudEvent:
    """Return the event of a campaign's run, `run` being a name of its own."""
    return CloudEvent(
        id=f"{run}-{event.seq}-{told_as(event)}",
        source=f"/saflite/{campaign}",
        type=f"saflite.{kind_of(event.fact)}",
        time=in_utc(event.at_unix_s).isoformat(timespec="microseconds"),
        sequence=f"{event.seq:012d}",
        data=event,
    )
