"""A model server that takes its time: OpenAI's protocol, one question at a time, a valid answer after a fixed wait.

Run as a process of its own: `python _slow_llm.py PORT SECONDS`. Its scores are drawn from the ids: noise.
"""

from __future__ import annotations

import json
import sys
import threading
import time
import zlib
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Handler(BaseHTTPRequestHandler):
    """Answers `/v1/models` at once and `/v1/chat/completions` after the wait, one after the other."""

    seconds = 10.0
    turn = threading.Lock()

    def do_GET(self) -> None:
        """List the one model."""
        self._send({"data": [{"id": "slow"}]})

    def do_POST(self) -> None:
        """Answer a question."""
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        schema = body.get("response_format", {}).get("json_schema", {}).get("schema", {})
        ids = schema.get("properties", {}).get("ranking", {}).get("items", {}).get("enum", [])
        with self.turn:
            time.sleep(self.seconds if ids else 0.05)
        rows = {name: {"interpretation": "", "effect": "", "score": zlib.crc32(name.encode()) % 11} for name in ids}
        content = json.dumps({"test_cases": rows, "ranking": ids})
        usage = {"prompt_tokens": 1, "completion_tokens": 1}
        choice = {"message": {"role": "assistant", "content": content}, "finish_reason": "stop"}
        self._send({"choices": [choice], "usage": usage})

    def _send(self, message: dict[str, object]) -> None:
        data = json.dumps(message).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def main() -> None:
    """Serve until killed."""
    Handler.seconds = float(sys.argv[2])
    ThreadingHTTPServer(("127.0.0.1", int(sys.argv[1])), Handler).serve_forever()


if __name__ == "__main__":
    main()
