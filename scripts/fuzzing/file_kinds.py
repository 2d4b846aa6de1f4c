"""All kinds of files from outside: valid ones, and what the commands that take them do with them."""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from file_mutations import Language, wrong
from mutations import drawn, encoded
from peer import plain
from works import works

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "unit" / "flight"))

from log_bytes import ardupilot_flight, px4_flight

from saflite.bus import keyring
from saflite.campaign.presets.campaigns import BUILTIN_DIR, load_campaign
from saflite.console.evaluation.evaluating import read_cases
from saflite.console.evaluation.labels import read_labels
from saflite.console.io import campaign_options, case_files, cases, toml_text
from saflite.console.io.farm_file import read_farm_file
from saflite.console.operations import log_judging, replaying
from saflite.console.run_data import known, provenance
from saflite.console.view import ci_files
from saflite.console.view.dashboard import access
from saflite.contract import wire
from saflite.contract.flight import pack_trace, unpack_trace
from saflite.contract.ids import digest
from saflite.contract.modules import forget, use
from saflite.contract.test_case import TestCase
from saflite.contract.work import FlyWork, RecordWork
from saflite.evidence.memory import MemoryBlobs
from saflite.flight.logs.files import read_log
from saflite.flight.mission import MISSIONS_DIR, dump_plan, load_plan, waypoints
from saflite.flight.plan_remarks import plan_remarks
from saflite.oracle.judge import judge
from saflite.oracle.policy import POLICIES_DIR, _foreign, load_policy
from saflite.recorder import mcap, recording
from saflite.recorder.exports.aerialist import write_case
from saflite.runtime import run_modules, webhook
from saflite.runtime.client import FarmInfo, read_info
from saflite.runtime.spool import Spool
from saflite.simulator_worker.registry import describe_target, load_target

POLICIES = ("min-obstacle-distance", "upright", "a-flip1", "a-rtl2")
NOW_S = 1_790_000_000.0
SAMPLES_RECORDED_MAX = 20_000
INPUTS_MAX = 4
POLICY_BYTES_MAX = 2_200
FORMULA_WORD = re.compile(rb"\b[a-z]+(?=\()|\b(?:since|until|not|implies|always|eventually)\b")


class FileKind(NamedTuple):
    """Valid files of one kind, where such a file lies in a folder, and what is done with it."""

    name: str
    language: Language
    valid: Callable[[], list[bytes]]
    use: Callable[[Path], object]
    made_wrong: Callable[[bytes, np.random.Generator], bytes] | None = None
    """Instead of what is done to every file of its language: behind checksums, or in a packed part."""


# ---- what is read -------------------------------------------------------------------------------------------------


class Flown(NamedTuple):
    """A flight of each of two campaigns, short: over obstacles, and with inputs."""

    work: RecordWork
    packed: bytes


@cache
def flown() -> tuple[Flown, ...]:
    """Return what the real services made of two test cases."""
    blobs, found = MemoryBlobs(), []
    for name in ("avoidance-m2", "policy-a-flip1"):
        work = next(work for work in works(name, blobs) if isinstance(work, RecordWork))
        assert work.flight.trace is not None
        found.append(Flown(work, blobs.get(work.flight.trace)))
    return tuple(found)


@cache
def proposed() -> tuple[TestCase, ...]:
    """Return test cases of two campaigns."""
    return tuple(
        work.test_case
        for name in ("avoidance-m2", "policy-a-flip1")
        for work in works(name, MemoryBlobs())
        if isinstance(work, FlyWork)
    )


def _texts(folder: Path, pattern: str, every: int = 1) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in sorted(folder.glob(pattern))[::every]]


def _yaml_cases() -> list[bytes]:
    """Return test cases with few inputs: the parser takes milliseconds for a thousand characters."""
    few = [msgspec.structs.replace(case, stimuli=case.stimuli[:INPUTS_MAX]) for case in proposed()]
    with tempfile.TemporaryDirectory() as folder:
        return [write_case(case, Path(folder), f"c{i}")[0].read_bytes() for i, case in enumerate(few)]


def _recordings() -> list[bytes]:
    return [mcap.write(*one, NOW_S) for one in flown()]


def _extract() -> list[bytes]:
    heads = "t_s,x,y,z,vx,roll_deg,yaw_deg,nav_state,arming_state,fix_type,satellites_used"
    rows = [f"{0.5 * i},{i},{-i},{-5 - i},1.0,{i % 7},,{(3, 5)[i > 20]},2,3,{10 + i % 3}" for i in range(40)]
    return ["\n".join([heads, *rows]).encode()]


@cache
def _keys() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="saflite-fuzz-keys-")) / "keys"
    keyring.init(folder, ["lab.example.org"], now_s=NOW_S)
    keyring.add(folder, "lab2", ["worker", "recorder"], now_s=NOW_S)
    return folder


def _json(value: object) -> Callable[[], list[bytes]]:
    return lambda: [msgspec.json.format(msgspec.json.encode(value))]


def _report() -> list[bytes]:
    from saflite.console.io.schema_examples import examples
    from saflite.contract.work import Report

    return [wire.encode(one) for one in examples(Report).values()]


# ---- what is done with it -----------------------------------------------------------------------------------------


def case(path: Path) -> None:
    """As `fly`, `score` and `mutate` take it, up to the flight."""
    if path.suffix == ".yaml":
        shutil.copy(MISSIONS_DIR / "mission2.plan", path.parent)
    found = cases.load_case(path)
    cases.check_layout(found, str(path))
    load_target(found.target.name).check(found)
    wire.checked(found, TestCase)
    case_files.one_line(found)
    write_case(found, path.parent / "written", "case")


def plan(path: Path) -> None:
    """As a campaign or a test case takes it."""
    mission = load_plan(path)
    plan_remarks(mission, str(path))
    waypoints(mission)
    dump_plan(mission)


def campaign(path: Path) -> None:
    """As `run` takes it, up to the first process."""
    found = campaign_options.changed(campaign_options.load(str(path)), budget=3)
    campaign_options.check_runnable(found)
    campaign_options.remarks(found)
    toml_text.dump(found)
    wire.encode(found)


def policy(path: Path) -> None:
    """As `run` and `--module` take it, and judged by."""
    _foreign.cache_clear()
    forget()
    use([path])
    forget()
    found = load_campaign(str(path))
    campaign_options.check_runnable(found)
    load_policy(str(path))
    for one in flown():
        judge(one.work.test_case, one.work.flight, unpack_trace(one.packed), found.policies, found.policy_texts)


def log(path: Path) -> None:
    """As `judge` takes it; every third as `evaluate logs` does, every third is recorded, too."""
    for beside in path.parent.iterdir():
        if beside.is_file() and beside != path:
            beside.unlink()
    way = zlib.crc32(path.read_bytes()) % 3  # the same for the same file, so that what fails can be handed in again
    if way == 0:
        read_cases(path.parent, read_labels(_labels_beside(path)))
        return
    judged = log_judging.judge_file(path, None, POLICIES)
    log_judging.as_csv([judged])
    log_judging.as_html([judged])
    if way == 1:
        _recorded(judged)


def _labels_beside(path: Path) -> Path:
    labels = path.parent / "written" / "labels.csv"
    labels.parent.mkdir(exist_ok=True)
    labels.write_text(f"log,interesting\n{path.stem},yes\n")
    return labels


def _recorded(judged: log_judging.Judged) -> None:
    assert judged.case is not None
    assert judged.flight is not None
    assert judged.judgement is not None
    trace = recording.read(judged.path).trace if judged.path.suffix == ".mcap" else read_log(judged.path).trace
    work = RecordWork(test_case=judged.case, flight=judged.flight, judgement=judged.judgement)
    if trace.samples < SAMPLES_RECORDED_MAX:
        mcap.write(work, pack_trace(trace), NOW_S)


def record(path: Path) -> None:
    """As `judge`, `replay` and `evaluate logs` take it."""
    replaying.entries(path, "", False, ())
    log(path)
    recording.verify(path)


def labels(path: Path) -> None:
    """As `evaluate logs` takes it."""
    read_labels(path).name_for(Path("log_12_2026.ulg"))


def summary(path: Path) -> None:
    """As an extract beside it is read."""
    beside = path.parent / "flight.csv"
    beside.write_bytes(_extract()[0])
    log_judging.judge_file(beside, None, POLICIES)


def register(path: Path) -> None:
    """As `keys list` takes it."""
    found = keyring.read_register(path.parent)
    [(peer.in_words(), found.named(peer.name)) for peer in found.peers]
    for peer in found.peers:
        (peer.may("c"), peer.may_order("pause"))


def peer_key(path: Path) -> None:
    """As `worker --keys` takes it."""
    for name in (keyring.PEER, keyring.CA, keyring.CERTIFICATE, keyring.KEY):
        if name != path.name:
            shutil.copy(_keys() / keyring.PEERS / "lab2" / name, path.parent / name)
    found = keyring.peer_credentials(path.parent, NOW_S)
    assert found.peer is not None
    (found.tls(), found.peer.may("c"), found.peer.in_words())


def modules(path: Path) -> None:
    """As `resume` and `replay` take it."""
    forget()
    run_modules.use(path.parent)
    forget()


def spooled(path: Path) -> None:
    """As a worker that comes back takes it."""
    for report in Spool(path.parent).waiting():
        wire.encode(report)


def corpus(path: Path) -> None:
    """As `regress` takes it and writes it again: nowhere but in the folder."""
    found = known.read(path.parent)
    known.with_standing(found, path.parent)
    folder = path.parent / "written" / "corpus"
    known.keep(found, folder)
    assert all(one.parent == folder for one in (path.parent / "written").rglob("*.json")), "written elsewhere"
    checks = [
        ci_files.Check(one.policy, one.name, "failed", one.behaviour, "warning", "new", "f", "p") for one in found
    ]
    ci_files.junit("nightly", checks).encode()
    ci_files.sarif("nightly", checks)


def tokens(path: Path) -> None:
    """As `dashboard --tokens` takes it."""
    found = access.read_tokens(path)
    assert access.role_of(found, "127.0.0.1", "") is None
    assert all(access.role_of(found, "x", token) == role for token, role in found.items())


# ---- behind checksums ---------------------------------------------------------------------------------------------


def _wrong_recording(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a recording with right checksums and wrong attachments, or any bytes."""
    if rng.random() < 0.4:
        return wrong(data, "bytes", rng)
    from io import BytesIO

    from mcap.reader import make_reader
    from mcap.writer import Writer

    parts = {one.name: one.data for one in make_reader(BytesIO(data)).iter_attachments()}
    name = list(parts)[int(rng.integers(len(parts)))]
    parts[name] = _wrong_trace(parts[name], rng) if name == "trace.bin" else wrong(parts[name], "json", rng)
    buffer = BytesIO()
    writer = Writer(buffer, enable_data_crcs=True)
    writer.start()
    for key, part in parts.items():
        writer.add_attachment(0, 0, key, "application/json", part)
    writer.finish()
    return buffer.getvalue()


def _wrong_trace(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a packed trace of wrong content, or any bytes."""
    if rng.random() < 0.2:
        return wrong(data, "bytes", rng)
    content = encoded(drawn(plain(unpack_trace(data)), rng)[0]) if rng.random() < 0.7 else None
    return zlib.compress(content if content is not None else wrong(zlib.decompress(data), "bytes", rng), 1)


def _wrong_report(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a spooled result whose digest fits."""
    body = encoded(drawn(msgspec.msgpack.decode(data), rng)[0]) if rng.random() < 0.7 else wrong(data, "bytes", rng)
    return digest(body).encode() + body


FARM = FarmInfo(campaign="night", endpoint="unixsock-stream//tmp/x", pid=5, processes={"books": 6})
MODULES = [{"kind": "policy", "name": "a", "file": "/nowhere/a.toml", "digest": "0" * 64}]


def _own_policies() -> list[bytes]:
    """Return policies under ids that do not ship: short ones, and the shortest with each word they lack."""
    kept, words = [], set[bytes]()
    for data in sorted(_texts(POLICIES_DIR, "*.toml")(), key=len):
        new = set(FORMULA_WORD.findall(data)) - words
        if new or len(data) <= POLICY_BYTES_MAX:
            kept.append(data.replace(b'id = "', b'id = "own-', 1))
            words |= new
    return kept


def _software() -> list[bytes]:
    return [msgspec.json.encode(provenance.here(describe_target("reference")))]


def _known() -> list[bytes]:
    one, name = proposed()[0], "0123456789abcdef"
    found = known.Known(
        fingerprint=name, name=name, policy="upright", behaviour="b", test_case=one, policies=("upright", "a-flip1")
    )
    return [msgspec.json.encode(found)]


FARM_FILE = b"""campaign = "avoidance-m2"
run = "run"
listen = "tls/lab.example.org:7447"
keys = "keys"
metrics = "127.0.0.1:9000"
modules = ["a.py"]
workers = { fly = 4, score = 1 }
scale = { judge = { min = 1, max = 3 } }
"""
CURSOR = webhook.Cursor(campaign="night", begun_unix_s=NOW_S, seq=7)
TOKENS = b"# who may\nviewer 0123456789abcdef0\noperator fedcba9876543210f\nabcdefabcdefabcdef\n"
SECRETS = (b"whsec_MDEyMzQ1Njc4OTAxMjM0NTY3ODkwMTIzNDU2Nzg5MDE=\n", b"0123456789012345678901234567890123456789\n")
LABELS = b"log_id,shows_issue\n12,true\n13,false\n"
ALL: tuple[FileKind, ...] = (
    FileKind("case.json", "json", lambda: [msgspec.json.encode(one) for one in proposed()], case),
    FileKind("case.yaml", "yaml", _yaml_cases, case),
    FileKind("mission.plan", "json", _texts(MISSIONS_DIR, "*.plan"), plan),
    FileKind("campaign.toml", "toml", _texts(BUILTIN_DIR, "*.toml"), campaign),
    FileKind("policy.toml", "toml", _own_policies, policy),
    FileKind("flight.mcap", "bytes", _recordings, record, _wrong_recording),
    FileKind("flight.trace", "bytes", lambda: [one.packed for one in flown()], log, _wrong_trace),
    FileKind("flight.ulg", "bytes", lambda: [px4_flight(tenths=40)], log),
    FileKind("flight.bin", "bytes", lambda: [ardupilot_flight(tenths=8)], log),
    FileKind("flight.csv", "words", _extract, log),
    FileKind("summary.csv", "words", lambda: [b"file,messages_warn_or_worse\nflight,a | b\nother,\n"], summary),
    FileKind("labels.csv", "words", lambda: [b"log,interesting\na,yes\nb,no\nc,unclear\n", LABELS], labels),
    FileKind("register.toml", "toml", lambda: [(_keys() / "register.toml").read_bytes()], register),
    FileKind("peer.toml", "toml", lambda: [(_keys() / "peers" / "lab2" / "peer.toml").read_bytes()], peer_key),
    FileKind("cert.pem", "words", lambda: [(_keys() / "peers" / "lab2" / "cert.pem").read_bytes()], peer_key),
    FileKind("farm.json", "json", _json(FARM), lambda path: read_info(path.parent)),
    FileKind("modules.json", "json", _json(MODULES), modules),
    FileKind("software.json", "json", _software, lambda path: provenance.differs(path.parent)),
    FileKind("0123456789abcdef-0123456789abcdef.json", "json", _known, corpus),
    FileKind("up.toml", "toml", lambda: [FARM_FILE], read_farm_file),
    FileKind("cursor.json", "json", _json(CURSOR), webhook.read_cursor),
    FileKind("tokens", "words", lambda: [TOKENS], tokens),
    FileKind("secret", "words", lambda: list(SECRETS), webhook.read_secret),
    FileKind("l.1.report", "bytes", _report, spooled, _wrong_report),
)
