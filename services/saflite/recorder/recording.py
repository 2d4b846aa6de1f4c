"""Read a recording back: test case, flight, verdicts and the bit-exact trace it carries."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import NamedTuple, TypeVar

from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, Trace, unpack_trace
from saflite.contract.outside import LOG_BYTES_MAX, read_bytes
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement
from saflite.contract.wire import UNREADABLE, unpack_json
from saflite.contract.work import PolicyTexts

T = TypeVar("T")
ATTACHMENTS_MAX = 64
"""We write four."""
SUMMARY_BYTES_MAX = 2**22
"""Of what tells where the rest lies: kinds of messages, and some 100 bytes for each MiB of them."""

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD, _FOOTER, _DATA_END = struct.Struct("<BQ"), struct.Struct("<BQQQI"), struct.Struct("<BQI")
_TAIL = _FOOTER.size + len(_MAGIC)


class Recording(NamedTuple):
    """What a recording attaches. `policy_texts` are the rules of one's own that it was judged by."""

    test_case: TestCase
    flight: Flight
    judgement: Judgement
    trace: Trace
    policy_texts: PolicyTexts


def read(path: Path) -> Recording:
    """Return what the recording holds; every checksum is verified on the way.

    Raises:
        Refused: the file is missing, truncated, damaged, or no recording of a flight.
    """
    parts = _attachments(path)
    return Recording(
        test_case=_decoded(parts, "test_case.json", TestCase, path),
        flight=_decoded(parts, "flight.json", Flight, path),
        judgement=_decoded(parts, "judgement.json", Judgement, path),
        trace=unpack_trace(_part(parts, "trace.bin", path)),
        policy_texts=_decoded({"policies.json": b"{}", **parts}, "policies.json", PolicyTexts, path),
    )


def verify(path: Path) -> int:
    """Return the number of messages after reading the whole file with its checksums; raises Refused if damaged."""
    from mcap.reader import make_reader

    try:
        reader = make_reader(io.BytesIO(_sound(path)), validate_crcs=True)
        summary = reader.get_summary()
        count = sum(1 for _ in reader.iter_messages())
    except _faults() as fault:
        raise _damaged(path, fault) from fault
    if summary is None or summary.statistics is None or summary.statistics.message_count != count:
        raise _damaged(path, f"{count} messages, not as many as its summary says")
    return count


def _attachments(path: Path) -> dict[str, bytes]:
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Attachment

    try:
        data = _sound(path)
        starts = _starts(data)
        if len(starts) > ATTACHMENTS_MAX:  # the same large one may be listed again and again
            raise _damaged(path, f"{len(starts)} attachments, not at most {ATTACHMENTS_MAX}")
        found, left, stream = dict[str, bytes](), len(data), io.BytesIO(data)
        for start in starts:
            if data[start : start + 1] != bytes([Opcode.ATTACHMENT]):  # the library would read whatever lies there
                raise _damaged(path, f"no attachment at byte {start}, where its summary says")
            stream.seek(start + _RECORD_HEAD.size)
            attachment = Attachment.read(ReadDataStream(stream))
            left -= len(attachment.data)
            if left < 0:  # one that lies within another is copied with each that it lies in
                raise _damaged(path, f"attachments of more than its {len(data)} bytes")
            found[attachment.name] = bytes(attachment.data)
    except _faults() as fault:
        raise _damaged(path, fault) from fault
    return found


def _starts(data: bytes) -> list[int]:
    """Return where the summary of a sound file says that attachments lie; raises ValueError for one that is too long.

    The library's own reader of summaries keeps all that stands there, and unpacks chunks, which have no place there:
    80 KB of one, packed, are 2.5 GB. What a record says of its own length is not checked by it, so no more is handed
    to it than what may be read at once.
    """
    from mcap.records import AttachmentIndex
    from mcap.stream_reader import StreamReader

    summary = data[_FOOTER.unpack_from(data, len(data) - _TAIL)[2] :]
    if len(summary) > SUMMARY_BYTES_MAX:
        raise ValueError(f"a summary of {len(summary)} bytes, not at most {SUMMARY_BYTES_MAX}")
    records = StreamReader(io.BytesIO(summary), skip_magic=True, emit_chunks=True).records
    return [record.offset for record in records if isinstance(record, AttachmentIndex)]


def _sound(path: Path) -> bytes:
    """Return the file, read once; raises ValueError unless the two checksums that together cover every byte are right.

    The reader checks chunks and attachments only. Layout after the MCAP specification: DataEnd (13 bytes, checksum of
    all before it), summary, footer (29 bytes, checksum of the summary and of the footer before it), magic.
    """
    data = read_bytes(path, "recording", LOG_BYTES_MAX)
    if len(data) < _TAIL + len(_MAGIC) or not data.startswith(_MAGIC) or not data.endswith(_MAGIC):
        raise ValueError("it does not begin and end as MCAP files do")
    opcode, _, summary, _, summary_sum = _FOOTER.unpack_from(data, len(data) - _TAIL)
    end = len(data) - _TAIL
    if opcode != 0x02 or not len(_MAGIC) + _DATA_END.size <= summary <= end:
        raise ValueError("no footer")
    data_end, _, data_sum = _DATA_END.unpack_from(data, summary - _DATA_END.size)
    if data_end != 0x0F or (data_sum and zlib.crc32(data[: summary - _DATA_END.size]) != data_sum):
        raise ValueError("checksum of the data section")
    if summary_sum and zlib.crc32(data[summary : len(data) - len(_MAGIC) - 4]) != summary_sum:
        raise ValueError("checksum of the summary")
    return data


def _faults() -> tuple[type[Exception], ...]:
    """Return what the reader raises on damaged files; which one depends on where the damage is."""
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    plain = (OSError, EOFError, struct.error, ValueError, RuntimeError, LookupError, OverflowError, MemoryError)
    return (*plain, McapError, ZstdError)


def _part(parts: dict[str, bytes], name: str, path: Path) -> bytes:
    if name not in parts:
        raise Refused("recording", where=str(path), expected=f"an attachment {name}", got=", ".join(parts) or "none")
    return parts[name]


def _decoded(parts: dict[str, bytes], name: str, kind: type[T], path: Path) -> T:
    try:
        return unpack_json(_part(parts, name, path), kind)
    except UNREADABLE as fault:
        raise Refused("recording", where=f"{path}, {name}", expected=f"a {kind.__name__}", got=str(fault)) from fault


def _damaged(path: Path, fault: object) -> Refused:
    got = f"a truncated or damaged file ({fault})" if str(fault) else "a truncated or damaged file"
    return Refused("recording", where=str(path), expected="a whole MCAP file", got=got)
