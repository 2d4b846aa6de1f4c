"""Hear of every violation of a farm, past and future: `python subscriber.py ENDPOINT` (see RUN/farm.json).

Over tls/HOST:PORT with the folder of a viewer's key (`saflite keys add`): `python subscriber.py ENDPOINT KEY`.
"""

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
for key in sys.argv[2:3]:
    shown = {"connect_private_key": f"{key}/key.pem", "connect_certificate": f"{key}/cert.pem"}
    tls = {"root_ca_certificate": f"{key}/ca.pem", "enable_mtls": True, "verify_name_on_connect": True, **shown}
    config.insert_json5("transport/link/tls", json.dumps(tls))
with zenoh.open(config) as session:
    history = ext.HistoryConfig(detect_late_publishers=True)
    ext.declare_advanced_subscriber(session, "saflite/2/*/event/violation", told, history=history)
    sys.stdin.read()  # until the end of input, or Ctrl-C
