"""An event as others outside the farm are told it over HTTP: CloudEvents 1.0, JSON format (cloudevents.io)."""

from __future__ import annotations

import msgspec

from saflite.contract.bounds import Word
from saflite.contract.clock import in_utc
from saflite.contract.events import Event, kind_of

CONTENT_TYPE = "application/cloudevents+json"


class CloudEvent(msgspec.Struct, frozen=True, kw_only=True):
    """One event. `id` and `source` together are its own for ever; `sequence` sorts as text (extension "sequence")."""

    specversion: str = "1.0"
    id: Word
    source: Word
    type: Word
    time: Word
    sequence: Word
    datacontenttype: str = "application/json"
    data: Event


def cloud_event(event: Event, campaign: str, run: str) -> CloudEvent:
    """Return the event of a campaign's run, `run` being a name of its own."""
    return CloudEvent(
        id=f"{run}-{event.seq}",
        source=f"/saflite/{campaign}",
        type=f"saflite.{kind_of(event.fact)}",
        time=in_utc(event.at_unix_s).isoformat(timespec="microseconds"),
        sequence=f"{event.seq:012d}",
        data=event,
    )
