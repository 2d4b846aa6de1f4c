"""Traces between their arrival and their judgement: from memory while they are young, from the store after that."""

from __future__ import annotations

from saflite.campaign.engine.outbox import Outbox
from saflite.campaign.engine.read_model import ReadModel
from saflite.contract.work import Outcome

MEMORY_MAX_BYTES = 32 * 2**20


class TraceCache:
    """The read model as the books see it: what is not committed yet can be read, too."""

    def __init__(self, out: Outbox, read_model: ReadModel | None) -> None:
        self._out, self._read_model = out, read_model
        self._young: dict[str, bytes] = {}
        self._bytes = 0

    def put(self, trace_digest: str, data: bytes) -> None:
        """Take a trace in; the store gets it with the next batch."""
        self._out.keep_trace(trace_digest, data)
        if trace_digest in self._young:
            return
        self._young[trace_digest] = data
        self._bytes += len(data)
        while self._bytes > MEMORY_MAX_BYTES and len(self._young) > 1:
            oldest = next(iter(self._young))
            self._bytes -= len(self._young.pop(oldest))

    def trace(self, trace_digest: str) -> bytes | None:
        """See `ReadModel.trace`."""
        data = self._young.get(trace_digest) or self._out.pending_trace(trace_digest)
        if data is None and self._read_model is not None:
            data = self._read_model.trace(trace_digest)
        return data

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """See `ReadModel.outcomes`."""
        assert self._read_model is not None, "old outcomes are asked for, but there is no read_model"
        return self._read_model.outcomes(after_round, upto_round, limit)

    def events(self, from_seq: int, limit: int) -> tuple[bytes, ...]:
        """See `ReadModel.events`."""
        return () if self._read_model is None else self._read_model.events(from_seq, limit)
