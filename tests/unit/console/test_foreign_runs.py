"""A run folder that others made: nothing is written, cut or removed outside of it, and nothing in it is obeyed."""

from __future__ import annotations

import os
import sqlite3
import struct
import zlib
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage import snapshot_file
from saflite.campaign.storage.seal import is_sealed
from saflite.campaign.storage.sqlite import connect_reading
from saflite.campaign.storage.store import Store
from saflite.campaign.storage.witness import accept_loss, start_of
from saflite.console.cli import main
from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference.describe import describe

REFUSED, UNAVAILABLE = 2, 3
WRITERS = (["prune"], ["resume"], ["audit", "--rebuild"], ["resume", "--accept-loss"])
FILES = (
    *("books.lock", "books.witness", "books.witness.part", "books.snapshot", "books.snapshot.part", "books.rebuilt"),
    *("books.seal", "books.sqlite-wal", "books.sqlite-shm", "farm.json", "farm.json.part", "software.json"),
    *("modules.json", "campaign.toml", "logs/books.log", "spool/fly-1/x.part", "recordings/x.mcap.part"),
    *("blobs/probe", "blobs/ab/x", "test_cases/x.yaml", "modules/0123/module.py"),
)
FOLDERS = ("blobs", "blobs/ab", "blobs/incoming", "blobs/incoming/fly-1", "recordings", "logs", "spool", "modules")


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A folder of the user's own, somewhere else."""
    folder = tmp_path / "outside"
    (folder / "incoming").mkdir(parents=True)
    for name in ("file", "incoming/file", "a" * 64):
        (folder / name).write_text("precious")
    return folder


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    campaign = load_campaign("avoidance-m2")
    Store.create(tmp_path / "run", campaign, template(campaign), describe()).close()
    return tmp_path / "run"


def _is_untouched(outside: Path) -> bool:
    files = {path.relative_to(outside).as_posix(): path.read_text() for path in outside.rglob("*") if path.is_file()}
    return files == dict.fromkeys(("file", "incoming/file", "a" * 64), "precious")


def _put(link: Path, target: Path) -> None:
    link.parent.mkdir(parents=True, exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to(target)


@pytest.mark.parametrize("words", WRITERS, ids=" ".join)
@pytest.mark.parametrize("name", [*FILES, *FOLDERS])
def test_a_link_in_a_run_is_refused_and_leads_nowhere(
    name: str, words: list[str], run_dir: Path, outside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _put(run_dir / name, outside if name in FOLDERS else outside / "file")
    command, *options = words
    code, said = main([command, str(run_dir), *options]), capsys.readouterr().err
    assert name.partition("/")[0].partition("-")[0] in said
    assert said.count("\n") == 1
    assert code == REFUSED or (code == UNAVAILABLE and name.startswith("books.sqlite-")), said  # SQLite's own refusal
    assert _is_untouched(outside)


@pytest.mark.parametrize("name", FILES)
def test_a_link_to_nothing_makes_nothing(name: str, run_dir: Path, tmp_path: Path) -> None:
    _put(run_dir / name, tmp_path / "made")
    assert main(["resume", str(run_dir)]) == REFUSED
    assert main(["prune", str(run_dir)]) == REFUSED
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("name", ["blobs", "recordings", "spool", "logs"])
def test_what_is_to_be_a_folder_is_refused_at_once_where_it_is_none(
    name: str, run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run_dir / name).write_text("")
    assert main(["resume", str(run_dir)]) == REFUSED
    assert name in capsys.readouterr().err


def test_links_are_refused_where_a_new_run_is_to_begin(tmp_path: Path, outside: Path) -> None:
    _put(tmp_path / "new" / "books.lock", outside / "file")
    campaign = load_campaign("avoidance-m2")
    with pytest.raises(Refused, match="link"):
        Store.create(tmp_path / "new", campaign, template(campaign), describe())
    assert _is_untouched(outside)


def test_a_new_run_is_closed_to_other_users(run_dir: Path) -> None:
    assert run_dir.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("words", WRITERS, ids=" ".join)
def test_nothing_is_written_where_others_can_write(
    words: list[str], run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir.chmod(0o777)
    files = {path: path.read_bytes() for path in run_dir.rglob("*") if path.is_file()}
    assert main([words[0], str(run_dir), *words[1:]]) == REFUSED
    assert "anybody can write" in capsys.readouterr().err
    assert files == {path: path.read_bytes() for path in run_dir.rglob("*") if path.is_file()}


@pytest.mark.parametrize("words", WRITERS, ids=" ".join)
@pytest.mark.parametrize("below", ["", "blobs", "spool"])
def test_nothing_is_written_where_a_group_can_write(
    below: str, words: list[str], run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run_dir / below).mkdir(exist_ok=True)
    (run_dir / below).chmod(0o775)
    group = next((one for one in os.getgroups() if one != os.getegid()), 12345 if os.geteuid() == 0 else None)
    if group is None:
        pytest.skip("this user is in no second group")
    os.chown(run_dir / below, -1, group)
    assert main([words[0], str(run_dir), *words[1:]]) == REFUSED
    assert "others of its group can write" in capsys.readouterr().err


@pytest.mark.parametrize("words", WRITERS, ids=" ".join)
@pytest.mark.parametrize("name", ["books.sqlite", "books.witness", "books.lock", "logs/books.log", "farm.json"])
def test_nothing_is_written_to_a_file_that_has_a_second_name(
    name: str, words: list[str], run_dir: Path, outside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run_dir / name).parent.mkdir(exist_ok=True)
    (run_dir / name).touch()
    os.link(run_dir / name, outside / "second")
    before = (outside / "second").read_bytes()
    assert main([words[0], str(run_dir), *words[1:]]) == REFUSED
    assert "hard link" in capsys.readouterr().err
    assert (outside / "second").read_bytes() == before


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("words", WRITERS, ids=" ".join)
def test_nothing_is_written_in_the_folder_of_another_user(
    words: list[str], run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.chown(run_dir, 12345, 12345)
    assert main([words[0], str(run_dir), *words[1:]]) == REFUSED
    assert "one of user 12345" in capsys.readouterr().err


def test_the_run_folder_itself_may_be_a_link(run_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(run_dir)
    assert main(["prune", str(tmp_path / "link")]) == 0


ENDLESS = "WITH RECURSIVE t(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM t) SELECT"
FOREIGN = {
    "a view in place of violations": [
        "ALTER TABLE violations RENAME TO v",
        f"CREATE VIEW violations AS {ENDLESS} x FROM t",
    ],
    "a view in place of meta": [
        "ALTER TABLE meta RENAME TO m",
        f"CREATE VIEW meta AS {ENDLESS} x AS key, x AS value FROM t",
    ],
    "a view in place of events": ["ALTER TABLE events RENAME TO e", f"CREATE VIEW events AS {ENDLESS} x AS seq FROM t"],
    "a view in place of a store of another version": [
        "UPDATE meta SET value = '7' WHERE key = 'format'",
        "ALTER TABLE journal RENAME TO j",
        f"CREATE VIEW journal AS {ENDLESS} x AS n FROM t",
    ],
    "a view besides": [f"CREATE VIEW more AS {ENDLESS} x FROM t"],
    "a trigger on what is written": ["CREATE TRIGGER t AFTER INSERT ON journal BEGIN DELETE FROM flights; END"],
    "a trigger on commits": ["CREATE TRIGGER t AFTER UPDATE ON meta BEGIN DELETE FROM journal WHERE n > 3; END"],
    "an index over an expression": ["CREATE INDEX i ON flights(hex(zeroblob(length(test_case) * 99999999)))"],
    "a generated column": ["ALTER TABLE flights ADD COLUMN more AS (hex(zeroblob(99999999)))"],
    "a virtual table": ["CREATE VIRTUAL TABLE more USING fts5(words)"],
    "another type of column": [
        "DROP TABLE recordings",
        "CREATE TABLE recordings (test_case, flight_index, digest, size_bytes)",
    ],
}


@pytest.mark.parametrize("statements", FOREIGN.values(), ids=FOREIGN)
def test_what_would_act_in_a_store_is_refused_before_it_does(
    statements: list[str], run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
    (run_dir / "books.seal").unlink()
    for words in (*WRITERS, ["audit"], ["report"], ["replay"], ["watch"], ["export", "--format", "csv"], ["artefacts"]):
        command, *options = words
        if "--rebuild" in options and "meta" not in " ".join(statements) and "journal" not in " ".join(statements):
            continue  # reads no other table
        assert main([command, str(run_dir), *options]) == REFUSED, command
        said = capsys.readouterr().err
        assert "books" in said.lower(), said
        assert said.count("\n") == 1, said


def test_a_value_larger_than_any_of_ours_is_not_read(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
        database.execute("UPDATE meta SET value = zeroblob(200000000) WHERE key = 'campaign'")
        database.commit()
    for command in ("report", "prune", "watch"):
        assert main([command, str(run_dir)]) == REFUSED
    assert "too big" in capsys.readouterr().err


@pytest.mark.parametrize("name", [b"\xff\xfe", b"a:b", b"", b"a" * 13])
def test_a_run_of_no_name_is_refused(name: bytes, run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It was a fault of our own code, with a traceback; leases of a run called `a:b` would be known by none."""
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as db, db:
        db.execute("UPDATE meta SET value = ? WHERE key = 'run_id'", (name,))
    for words in (["audit"], ["audit", "--rebuild"], ["resume"], ["resume", "--accept-loss"]):
        assert main([words[0], str(run_dir), *words[1:]]) == REFUSED, words
        assert "books (run_id): expected 12 hexadecimal digits" in capsys.readouterr().err


@pytest.mark.parametrize("count", [b"9" * 5_000, b"9" * 30, b"x", b"-1", b""])
def test_commits_without_a_count_are_lost_and_begun_anew_where_that_is_accepted(count: bytes, run_dir: Path) -> None:
    with closing(Store.open(run_dir)) as store:
        books = store.rebuild()
        books.begin(1.0, 1.7e9)
        store.commit(books.drain())
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as db, db:
        db.execute("UPDATE meta SET value = ? WHERE key = 'commits'", (count,))
    assert main(["audit", str(run_dir)]) == UNAVAILABLE
    accept_loss(run_dir)
    Store.open(run_dir).close()


@pytest.mark.parametrize("chain", [-1, 2**32, 2**62])
def test_a_checksum_that_none_can_be_is_told(chain: int, run_dir: Path) -> None:
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as db, db:
        db.execute("INSERT INTO events VALUES (1, 'fault', 0, ?, x'00')", (chain,))
    with pytest.raises(Refused, match="values as saflite writes them"):
        accept_loss(run_dir)


@pytest.mark.parametrize("name", ["../outside/file", "a/b", "..", "", "-x", "a\nb"])
def test_a_run_names_no_target_that_leads_elsewhere(
    name: str, run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files are named by it: the script that is made of a finding."""
    named = wire.encode(msgspec.structs.replace(describe(), name=name))
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as db, db:
        db.execute("UPDATE meta SET value = ? WHERE key = 'target'", (named,))
    assert main(["export", str(run_dir), "--format", "csv", "--out", str(run_dir.parent / "out")]) == REFUSED
    assert "`$.name`" in capsys.readouterr().err


def test_a_store_that_is_long_and_holds_nothing_is_not_read_for_hours(run_dir: Path) -> None:
    os.truncate(run_dir / "books.sqlite", 2**40)  # it takes no more room than before
    assert main(["audit", str(run_dir)]) == 0
    assert main(["report", str(run_dir)]) == 0
    assert not is_sealed(run_dir)


@pytest.mark.parametrize("packed", [zlib.compress(bytes(2**29), 9), b"not packed", b"", zlib.compress(b"x")[:-1]])
def test_a_snapshot_that_unpacks_without_end_or_not_at_all_is_not_used(
    packed: bytes, run_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(connect_reading(run_dir / "books.sqlite")) as database:
        start = start_of(database)
        head = snapshot_file._HEAD.pack(snapshot_file.code(), start, 0, 0)
        (run_dir / "books.snapshot").write_bytes(head + packed + snapshot_file._check(head, packed))
        assert snapshot_file.kept(run_dir, start, database) is None
    assert "is not used" in caplog.text


@pytest.mark.parametrize("state", [b"", b"\xc1", b"\x90", b"\x91" * 10**6, b"\xdd\xff\xff\xff\xff", b"\x80", b"\xc0"])
def test_a_snapshot_that_holds_no_books_is_not_used(
    state: bytes, run_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(connect_reading(run_dir / "books.sqlite")) as database:
        start = start_of(database)
    snapshot_file.keep(run_dir, start, 0, 0, state)
    store = Store.open(run_dir)
    assert store.rebuild().snapshot() != state
    store.close()
    assert "the snapshot is not used" in caplog.text


@pytest.mark.parametrize(("part", "value"), [("latest", [[[], 2**63]]), ("latest", [[[], "x"]]), ("rounds", [1] * 9)])
def test_a_snapshot_of_books_that_cannot_be_is_not_used(
    part: str, value: object, run_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = Store.open(run_dir)
    state = msgspec.msgpack.decode(store.rebuild().snapshot())
    state[0][part] = value
    store.close()
    with closing(connect_reading(run_dir / "books.sqlite")) as database:
        start = start_of(database)
    snapshot_file.keep(run_dir, start, 0, 0, msgspec.msgpack.encode(state))
    store = Store.open(run_dir)
    store.rebuild()
    store.close()
    assert "the snapshot is not used" in caplog.text


def test_nobody_goes_on_from_a_snapshot_that_another_user_made(
    run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It may contradict itself in ways that no journal can, and say what the journal does not."""
    store = Store.open(run_dir)
    true = store.rebuild().snapshot()
    store.close()
    state = msgspec.msgpack.decode(true)
    state[1][3][1] = ["no test case of this run"]  # finds that are not decided upon: books would look for it
    with closing(connect_reading(run_dir / "books.sqlite")) as database:
        start = start_of(database)
    with monkeypatch.context() as other:
        other.setenv("XDG_DATA_HOME", str(tmp_path / "other"))
        snapshot_file.keep(run_dir, start, 0, 0, msgspec.msgpack.encode(state))
    store = Store.open(run_dir)
    books = store.rebuild()
    assert books.snapshot() == true
    books.begin(0.0, 1.7e9)
    store.close()
    assert "is of another user and not used" in caplog.text


def test_a_snapshot_of_this_user_is_gone_on_from(run_dir: Path, caplog: pytest.LogCaptureFixture) -> None:
    store = Store.open(run_dir)
    state = msgspec.msgpack.decode(store.rebuild().snapshot())
    state[0]["counts"][0] = 77  # flights: so that it shows
    with closing(connect_reading(run_dir / "books.sqlite")) as database:
        snapshot_file.keep(run_dir, start_of(database), 0, 0, msgspec.msgpack.encode(state))
    assert store.rebuild().status(0.0).flights == 77
    store.close()
    assert not caplog.text


def _journal_naming(victim: Path, store: Path) -> bytes:
    """A rollback journal without pages that names another file, as SQLite's file format has it (section 3)."""
    data, magic, name = store.read_bytes(), bytes.fromhex("d9d505f920a163d7"), str(victim).encode()
    page = struct.unpack(">H", data[16:18])[0]
    head = magic + struct.pack(">5I", 0, 1, len(data) // page, 512, page)
    tail = struct.pack(">I", 2**30 // page + 1) + name + struct.pack(">2I", len(name), sum(name)) + magic
    return head.ljust(512, b"\0") + tail


@pytest.mark.parametrize("words", [*WRITERS, ["report"], ["audit"], ["replay"]], ids=" ".join)
def test_a_journal_that_has_other_files_removed_is_refused(
    words: list[str], run_dir: Path, outside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run_dir / "books.sqlite-journal").write_bytes(_journal_naming(outside / "file", run_dir / "books.sqlite"))
    assert main([words[0], str(run_dir), *words[1:]]) == REFUSED
    assert "names another file" in capsys.readouterr().err
    assert _is_untouched(outside)


@pytest.mark.parametrize("suffix", ["", "-wal", "-shm", "-journal"])
@pytest.mark.parametrize("words", [*WRITERS, ["report"], ["audit"], ["artefacts"]], ids=" ".join)
def test_no_pipe_beside_a_store_is_waited_for(
    words: list[str], suffix: str, run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run_dir / f"books.sqlite{suffix}").unlink(missing_ok=True)
    os.mkfifo(run_dir / f"books.sqlite{suffix}")
    assert main([words[0], str(run_dir), *words[1:]]) == REFUSED
    assert capsys.readouterr().err.count("\n") == 1


PLACES = {"report": "report.html", "export": "export-yaml"}


@pytest.mark.parametrize("command", PLACES)
def test_what_is_made_of_a_run_of_others_goes_elsewhere(
    command: str, run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [command, str(run_dir), *(["--format", "yaml"] if command == "export" else [])]
    run_dir.chmod(0o777)
    assert main(words) == REFUSED
    assert "anybody can write" in capsys.readouterr().err
    assert not (run_dir / PLACES[command]).exists()
    assert main([*words, "--out", str(tmp_path / "made")]) == 0


def test_an_export_follows_no_link_in_a_run(run_dir: Path, outside: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _put(run_dir / "export-yaml", outside)
    assert main(["export", str(run_dir), "--format", "yaml"]) == REFUSED
    assert "symbolic link" in capsys.readouterr().err
    assert _is_untouched(outside)


def test_a_report_takes_the_place_of_a_link(run_dir: Path, outside: Path) -> None:
    _put(run_dir / "report.html", outside / "file")
    assert main(["report", str(run_dir)]) == 0
    assert _is_untouched(outside)
