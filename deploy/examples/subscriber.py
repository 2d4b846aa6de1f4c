"""Hear of every violation of a farm, past and future: `python subscriber.py ENDPOINT` (see RUN/farm.json)."""

import json
import sys

import msgspec
import zenoh
from zenoh import ext


def told(sample: zenoh.Sample) -> None:
    """Print one violation; the schema of the message is schemas/Event.schema.json."""
    violation = msgspec.msgpack.decode(sample.payload.to_bytes())["fact"]["violation"]
    print(violation["confirmation"], violation["fingerprint"], violation["policy"], violation["robustness"], flush=True)


config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:2]))
with zenoh.open(config) as session:
    history = ext.HistoryConfig(detect_late_publishers=True)
    ext.declare_advanced_subscriber(session, "saflite/2/*/event/violation", told, history=history)
    sys.stdin.read()  # until the end of input, or Ctrl-C
