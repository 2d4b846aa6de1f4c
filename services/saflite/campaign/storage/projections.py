"""Tables of the store. `journal` is the truth; the others say the same for people, queries and reports."""

from __future__ import annotations

FORMAT = 3
"""Version of the store; a store of another version is refused."""

TABLES: dict[str, tuple[str, ...]] = {
    "test_cases": (
        "test_case TEXT PRIMARY KEY",
        "round INTEGER",
        "place INTEGER",
        "strategy TEXT",
        "parent TEXT",
        "content BLOB",
    ),
    "scores": (
        "test_case TEXT",
        "round INTEGER",
        "model TEXT",
        "scored_by TEXT",
        "value REAL",
        "shadow INTEGER",
        "fault TEXT",
        "reason TEXT",
        "model_digest TEXT",
        "prompt_digest TEXT",
        "PRIMARY KEY (test_case, round, model, shadow)",
    ),
    "usage": (
        "round INTEGER",
        "batch INTEGER",
        "model TEXT",
        "tokens_in INTEGER",
        "tokens_out INTEGER",
        "latency_s REAL",
        "cost_usd REAL",
        "calls INTEGER",
        "asked_again INTEGER",
        "cached INTEGER",
        "faults INTEGER",
        "PRIMARY KEY (round, batch, model)",
    ),
    "selected": (
        "test_case TEXT PRIMARY KEY",
        "round INTEGER",
        "rank INTEGER",
        "selected_by TEXT",
        "score REAL",
        "novelty REAL",
    ),
    "flights": (
        "test_case TEXT",
        "purpose TEXT",
        "flight_index INTEGER",
        "ending TEXT",
        "simulated_s REAL",
        "wall_s REAL",
        "trace_digest TEXT",
        "worker TEXT",
        "message TEXT",
        "build TEXT",
        "PRIMARY KEY (test_case, purpose, flight_index)",
    ),
    "judgements": (
        "test_case TEXT",
        "flight_index INTEGER",
        "robustness REAL",
        "violated TEXT",
        "content BLOB",
        "PRIMARY KEY (test_case, flight_index)",
    ),
    "violations": (
        "fingerprint TEXT",
        "test_case TEXT",
        "policy TEXT",
        "confirmation TEXT",
        "robustness REAL",
        "severity TEXT",
        "content BLOB",
        "PRIMARY KEY (test_case, policy)",
    ),
    "endings": ("test_case TEXT PRIMARY KEY", "state TEXT", "ending TEXT", "flights INTEGER"),
    "outcomes": (
        "round INTEGER",
        "rank INTEGER",
        "test_case TEXT",
        "content BLOB",
        "PRIMARY KEY (round, rank)",
    ),
    "recordings": (
        "test_case TEXT",
        "flight_index INTEGER",
        "file TEXT",
        "digest TEXT",
        "size_bytes INTEGER",
        "PRIMARY KEY (test_case, flight_index)",
    ),
    "attempts": (
        "work TEXT",
        "epoch INTEGER",
        "stage TEXT",
        "worker TEXT",
        "from_unix_s REAL",
        "to_unix_s REAL",
        "how TEXT",
        "message TEXT",
        "PRIMARY KEY (work, epoch)",
    ),
}

CREATE = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value BLOB) WITHOUT ROWID",
    "CREATE TABLE journal (n INTEGER PRIMARY KEY, chain INTEGER NOT NULL, line BLOB NOT NULL)",
    "CREATE TABLE events (seq INTEGER PRIMARY KEY, kind TEXT, at_unix_s REAL, chain INTEGER NOT NULL, event BLOB)",
    *(f"CREATE TABLE {table} ({', '.join(columns)})" for table, columns in TABLES.items()),
)


def _columns(table: str) -> int:
    return sum(1 for column in TABLES[table] if not column.startswith("PRIMARY KEY"))


def _key_places(table: str) -> tuple[int, ...]:
    names = [column.split()[0] for column in TABLES[table] if not column.startswith("PRIMARY KEY")]
    compound = next((column for column in TABLES[table] if column.startswith("PRIMARY KEY")), "")
    if not compound:
        return (0,)
    return tuple(names.index(name.strip()) for name in compound[compound.index("(") + 1 : -1].split(","))


KEYS: dict[str, tuple[int, ...]] = {table: _key_places(table) for table in TABLES}
"""Which values of a row name it."""

INSERT: dict[str, str] = {
    table: f"INSERT OR REPLACE INTO {table} VALUES ({', '.join('?' * _columns(table))})"  # noqa: S608 (our own names)
    for table in TABLES
}
