"""The dashboard's application without a browser: who may see and order what, what the pages hold."""

from __future__ import annotations

import asyncio
import re
import socket
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import msgspec
import pytest
from dashboard_runs import make_run
from starlette.requests import Request
from starlette.testclient import TestClient

from saflite.console.cli import main
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.run_folder import RunFolder
from saflite.console.view import html_text
from saflite.console.view.dashboard import access, pages
from saflite.console.view.dashboard.app import _Site, application
from saflite.console.view.dashboard.source import _PARTS, REST, Figures, Head, RunSource
from saflite.contract.control import Answer, Verb
from saflite.contract.errors import Refused
from saflite.contract.flight import AUTOPILOT_ALIVE
from saflite.contract.verdict import Violation

EVIL = "<script>alert(1)</script>"
VIOLATION = Violation(
    fingerprint="0123456789abcdef",
    test_case="fedcba9876543210",
    policy="upright",
    robustness=-1.0,
    severity="soft",
    confirmation="confirmed",
    behaviour=f"upright, soft, {EVIL}",
)


class Stub:
    """A campaign that is told what to show, and remembers orders."""

    def __init__(self, name: str = "night", began_unix_s: float = 0.0, found: tuple[Violation, ...] = ()) -> None:
        self._head = Head(name, EVIL, "reference", "abcdef012345", began_unix_s)
        self.found, self.orders, self.version = list(found), list[tuple[Verb, str, int]](), 1

    def head(self) -> Head:
        return self._head

    def settings(self) -> str:
        return ""

    def figures(self) -> Figures:
        return Figures(
            state="running",
            flights=3,
            budget=9,
            reflown=2,
            behaviours=1,
            finds=4,
            flaky=0,
            elapsed_s=12.0,
            version=self.version,
        )

    def violations(self, *, public: bool) -> list[Violation]:
        return [one for one in self.found if not public or one.policy != AUTOPILOT_ALIVE]

    def part(self, name: str) -> str:
        raise Refused("part", expected="one", got=name)

    def find(self, test_case: str, *, public: bool) -> str:
        return f"<p>{test_case}</p>"

    def file(self, name: str, *, public: bool) -> Path | None:
        return None

    def order(self, verb: Verb, text: str, number: int) -> Answer:
        self.orders.append((verb, text, number))
        return Answer(accepted=True, message="done")


def client(*sources: Stub, tokens: access.Tokens | None = None, host: str = "127.0.0.1:8765") -> TestClient:
    app = application(sources or (Stub(),), tokens or {}, is_ours=lambda client, server: True)
    return TestClient(app, base_url=f"http://{host}", follow_redirects=False)


ORDER = {"verb": "budget", "number": 50}
HEADER = {"X-Saflite": "1"}


def test_without_tokens_only_names_of_this_machine_are_answered_to() -> None:
    assert client().get("/run/0/").status_code == 200
    assert client(host="localhost:1").get("/run/0/").status_code == 200
    assert client(host="evil.example:8765").get("/run/0/").status_code == 403


def test_sockets_of_others_get_nothing() -> None:
    app = application([Stub()], {}, is_ours=lambda client, server: False)
    assert TestClient(app, base_url="http://127.0.0.1").get("/run/0/").status_code == 403
    web = TestClient(application([Stub()], {}), base_url="http://127.0.0.1")
    assert web.get("/run/0/").status_code == 403, "no socket that the kernel lists"


@pytest.mark.parametrize(("family", "host"), [(socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")], ids=str)
def test_only_a_socket_that_somebody_holds_says_whose_it_is(family: socket.AddressFamily, host: str) -> None:
    def place(one: socket.socket) -> tuple[str, int]:
        host, port, *_ = one.getsockname()
        return host, port

    with socket.socket(family) as here, socket.socket(family) as elsewhere:
        for listener in (here, elsewhere):
            listener.bind((host, 0))
            listener.listen()
        assert not access.is_ours(place(here), place(here)), "it listens, nobody asks by it"
        asks = socket.create_connection(place(here))
        client, server = place(asks), place(here)
        taken = here.accept()[0]
        assert access.is_ours(client, server)
        assert not access.is_ours(client, place(elsewhere)), "a socket may share its address with one to another place"
        asks.close()
        assert not access.is_ours(client, server), "closed, and listed under user 0 until the other side has closed"
        taken.close()
        assert not access.is_ours(client, server), "closed by both, and listed under user 0 for a minute"
    assert not access.is_ours(("testclient", 50000), ("testserver", 80))


STATES = {f"{number:02X}": number == 1 for number in range(1, 13)}  # of include/net/tcp_states.h; 01 is ESTABLISHED
ROW = (
    "   0: 0100007F:C350 0100007F:2235 {state} 00000000:00000000 00:00000000 00000000 {user:5d}        0 {inode} "
    "1 0000000000000000 20 4 30 10 -1"
)


@pytest.mark.parametrize(("state", "holds"), STATES.items())
def test_what_the_kernel_lists_says_whose_a_socket_is_while_it_is_held(state: str, holds: bool) -> None:
    client, server = ("127.0.0.1", 50000), ("127.0.0.1", 8757)
    stranger = ROW.format(state="01", user=65534, inode=1)
    for user, inode in product((0, 1000, 65534), (0, 4711)):
        row = ROW.format(state=state, user=user, inode=inode)
        owners = access.owners([row], client, server)
        assert owners == ({user} if holds and inode else set())
        assert access.owners([row, stranger], client, server) == owners | {65534}
        for other in ((client, ("127.0.0.1", 8758)), (("127.0.0.1", 50001), server), (("127.0.0.2", 50000), server)):
            assert access.owners([row], *other) == set()


def test_a_token_gives_a_role_and_a_cookie() -> None:
    tokens: dict[str, access.Role] = {"v" * 16: "viewer", "o" * 16: "operator"}
    secret = msgspec.structs.replace(VIOLATION, policy=AUTOPILOT_ALIVE)
    source = Stub(found=(secret,))
    web = client(source, tokens=tokens, host="lab:80")
    assert web.get("/run/0/").status_code == 401
    assert web.get("/run/0/", headers={"Authorization": "Bearer wrong"}).status_code == 401
    entered = web.get(f"/run/0/?token={'v' * 16}")
    assert (entered.status_code, entered.headers["location"]) == (303, "/run/0/")
    assert "httponly" in entered.headers["set-cookie"].lower()
    page = web.get("/run/0/")
    assert page.status_code == 200
    assert secret.test_case not in page.text, "viewers see no findings of memory safety"
    assert 'id="pause"' not in page.text, "viewers see no orders"
    assert web.post("/run/0/order", json=ORDER, headers=HEADER).status_code == 403
    assert source.orders == []
    bearer = {"Authorization": f"Bearer {'o' * 16}", **HEADER}
    web.cookies.clear()
    assert secret.test_case in web.get("/run/0/", headers=bearer).text
    assert web.post("/run/0/order", json=ORDER, headers=bearer).json() == {"accepted": True, "message": "done"}
    assert source.orders == [("budget", "", 50)]


@pytest.mark.parametrize("path", ["//evil.example/", "///evil.example/", "//evil.example//x", "/%2f/evil.example/"])
def test_a_token_leads_to_no_other_host(path: str) -> None:
    for tokens in ({}, {"0123456789abcdef": "viewer"}):
        web = client(tokens=tokens)  # type: ignore[arg-type]
        url = web.build_request("GET", "/").url.copy_with(raw_path=f"{path}?token=0123456789abcdef".encode())
        place = web.get(url).headers.get("location", "/")
        assert place.startswith("/")
        assert not place.startswith(("//", "/\\", "/%5c"))


def test_an_order_longer_than_any_is_not_read_to_its_end() -> None:
    read = []

    def parts() -> Iterator[bytes]:
        for number in range(1000):
            read.append(number)
            yield b" " * 4096

    answer = client().post("/run/0/order", content=parts(), headers=HEADER)
    assert answer.status_code == 400
    assert "at most" in answer.json()["message"]


def test_a_recording_that_is_a_link_is_not_handed_out(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    make_run(tmp_path / "run", 2)
    (tmp_path / "run" / "recordings").mkdir(exist_ok=True)
    (tmp_path / "run" / "recordings" / "a-0.mcap").symlink_to(tmp_path / "secret")
    assert RunSource(tmp_path / "run").file("a-0.mcap", public=False) is None
    (tmp_path / "run" / "recordings" / "b-0.mcap").write_text("ours")
    assert RunSource(tmp_path / "run").file("b-0.mcap", public=False) is not None
    too_long = (f"{'a' * 300}.mcap", f"{chr(0x1F600) * 90}.mcap")  # for a file system, in characters or in bytes alone
    for name in ("../secret", "../../secret", "b-0.mcap/", "/etc/passwd", "..", "", *too_long, "a\0.mcap"):
        assert RunSource(tmp_path / "run").file(name, public=False) is None


def test_orders_need_the_header_and_a_known_verb() -> None:
    source = Stub()
    web = client(source)
    assert web.post("/run/0/order", json=ORDER).status_code == 403
    assert web.post("/run/0/order", json={"verb": "events"}, headers=HEADER).status_code == 400
    assert web.post("/run/0/order", content=b"x" * 9000, headers=HEADER).status_code == 400
    assert source.orders == []


def test_what_came_from_elsewhere_is_escaped_and_nothing_else_runs() -> None:
    page = client(Stub(found=(VIOLATION,))).get("/run/0/")
    assert EVIL not in page.text
    assert "&lt;script&gt;" in page.text
    assert "script-src 'self'" in page.headers["content-security-policy"]
    assert client().get("/run/7/").status_code == 404
    assert client().get("/run/0/part/nosuch").status_code == 404
    assert client().get("/assets/nosuch").status_code == 404


HIDDEN = ("\u202e", "\u2066", "\u200b", "\u200d", "\ufeff", "\u00ad", "\u2028", "\x9b", "\U000e0041", "\x1b", "\x00")


@pytest.mark.parametrize("char", HIDDEN, ids=ascii)
def test_no_text_of_others_hides_or_turns_what_a_page_says(char: str) -> None:
    found = msgspec.structs.replace(VIOLATION, behaviour=f"upright{char}thgirpu", message=f"it fell{char}not")
    web = client(Stub(f"night{char}thgin", found=(found,)))
    for text in (web.get("/run/0/").text, html_text.escape(f"<b{char}>")):
        assert char not in text
        assert "\\" in text


def test_several_runs_stand_in_order_of_time() -> None:
    text = client(Stub("late", 2e9, (VIOLATION,)), Stub("early", 1e9)).get("/").text
    assert text.index("early") < text.index("late")
    assert f'href="/run/0/#{VIOLATION.test_case}"' in text
    assert client(Stub()).get("/").headers["location"] == "/run/0/"


def test_runs_of_one_campaign_and_build_are_told_apart() -> None:
    runs = [Stub("night", at, (VIOLATION,)) for at in (1e9, 2e9)]
    for run, folder in zip(runs, ("first ü", "second"), strict=True):
        run._head = run._head._replace(where=folder)
    text = client(*runs).get("/").text
    assert all(f'<a href="/run/{at}/">{folder}</a>' in text for at, folder in enumerate(("first ü", "second")))
    heads = re.findall(r'class="build"[^>]*>([^<]*)<', text)
    assert heads == ["1", "2"]


def test_behaviours_of_one_run_that_share_their_words_are_counted() -> None:
    others = (msgspec.structs.replace(VIOLATION, fingerprint=char * 16, test_case=char * 16) for char in "ab")
    text = client(Stub("early", 1e9, (VIOLATION, *others)), Stub("late", 2e9, (VIOLATION,))).get("/").text
    marks = re.findall(r'<td class="mark"><a class="dot-confirmed"[^>]*>([^<]*)</a>', text)
    assert marks == ["●&thinsp;3", "●"]


def test_a_page_keeps_its_size_whatever_a_run_found() -> None:
    many = tuple(
        msgspec.structs.replace(VIOLATION, test_case=f"{number:016x}", robustness=-float(number))
        for number in range(10_000)
    )
    text = client(Stub(found=many)).get("/run/0/").text
    assert text.count('<tr class="find"') == pages.FINDS_SHOWN
    assert f"and {len(many) - pages.FINDS_SHOWN} more" in text
    assert f'data-find="{many[-1].test_case}"' in text  # the worst
    assert len(text.encode()) < 600 * pages.FINDS_SHOWN


def test_the_stream_tells_figures_and_finds_as_they_come() -> None:
    source = Stub()
    messages = [{"type": "http.request"}, {"type": "http.request"}, {"type": "http.disconnect"}]

    async def receive() -> dict[str, str]:
        return messages.pop(0)

    async def told() -> list[str]:
        found = []
        request = Request({"type": "http", "state": {"role": "operator"}}, receive)
        stream = _Site([source], 0.0, asyncio.Event())._stream(request, source)
        async for text in stream:
            found.append(text)
            source.found, source.version = [VIOLATION], 2
        return found

    first, table, second = asyncio.run(told())
    assert msgspec.json.decode(first.removeprefix("data: "))["flights"] == 3
    assert second.startswith("data: ")
    assert table.startswith("event: finds\n")
    assert VIOLATION.test_case in table


def test_a_run_shows_its_books(tmp_path: Path) -> None:
    source = RunSource(make_run(tmp_path / "run", 12))
    figures, found = source.figures(), source.violations(public=False)
    assert (figures.state, figures.flights, figures.budget) == ("ended", 12, 12)
    assert found, "the simulated farm finds something"
    for name in ("search", "coverage", "faults", "scorers"):
        assert "<" in source.part(name), name
    alone = source.find(found[0].test_case, public=False)
    assert found[0].fingerprint in alone
    assert f"<h3>{found[0].policy} " in alone, "no number: it is the only one on the page"
    assert found[0].test_case in pages.of_run(0, source, "operator", alone=True)
    with pytest.raises(Refused):
        source.part("nosuch")
    with pytest.raises(Refused):
        source.find("nosuch", public=False)
    assert source.file("../books.sqlite", public=False) is None


def test_a_part_rests_while_flights_go_on_and_is_new_once_they_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, runs, made = RunSource(make_run(tmp_path / "run", 4)), [True], list[int]()
    monkeypatch.setattr(farm_lookup, "is_running", lambda _place: runs[0])

    def make(_run: RunFolder) -> str:
        made.append(1)
        return str(len(made))

    monkeypatch.setitem(_PARTS, "faults", make)

    def age(seconds: float) -> None:
        """Let something have happened since it was made, `seconds` ago, in 2 s."""
        kept = source._kept["faults"]
        source._kept["faults"] = kept._replace(version=-1, made_s=source._clock.monotonic_s() - seconds, took_s=2.0)

    assert [source.part("faults"), source.part("faults")] == ["1", "1"]
    age(REST)
    assert source.part("faults") == "1", "made a moment ago, for what it takes"
    age(3 * REST)
    assert source.part("faults") == "2"
    age(REST)
    runs[0] = False
    assert source.part("faults") == "3", "the last word"


@pytest.mark.parametrize(
    ("content", "expected"), [("", "none"), ("short\n", "16 characters"), ("admin 0123456789abcdef0\n", "viewer TOKEN")]
)
def test_tokens_that_are_none_are_refused(tmp_path: Path, content: str, expected: str) -> None:
    (tmp_path / "tokens").touch(0o600)
    (tmp_path / "tokens").write_text(content)
    with pytest.raises(Refused, match=expected):
        access.read_tokens(tmp_path / "tokens")


def test_another_address_needs_tokens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tokens").touch(0o600)
    (tmp_path / "tokens").write_text("viewer 0123456789abcdef\noperator fedcba9876543210\n")
    assert access.read_tokens(tmp_path / "tokens") == {"0123456789abcdef": "viewer", "fedcba9876543210": "operator"}
    assert main(["dashboard", "nosuch", "--host", "0.0.0.0"]) == 2
    assert "--tokens" in capsys.readouterr().err
    assert main(["dashboard", str(tmp_path)]) == 2
    for host in ("127.0.0.1", "localhost", "::1"):
        access.check_address(host, {})


@pytest.mark.parametrize("number", ["1", "-1", "9" * 5_000, "0x0", "\u0660", "%00", "0%0a"])
@pytest.mark.parametrize("rest", ["", "part/search", "find/x", "recordings/x", "events"])
def test_a_run_that_is_not_there_is_no_fault(number: str, rest: str) -> None:
    assert client(Stub("night")).get(f"/run/{number}/{rest}").status_code == 404


@pytest.mark.parametrize("when", ["before", "while it is served"])
@pytest.mark.parametrize("damage", ["cut", "removed"])
def test_a_run_that_cannot_be_read_is_named_and_hides_no_other(tmp_path: Path, when: str, damage: str) -> None:
    folders = [make_run(tmp_path / name, 2, rng_seed=seed) for seed, name in enumerate(("first", "second", "third"), 1)]
    sources = [RunSource(folder) for folder in folders]
    whole = client(*sources).get("/")  # type: ignore[arg-type]
    assert (whole.status_code, "hard" in whole.text) == (200, False)
    store = folders[1] / "books.sqlite"
    if damage == "cut":
        store.write_bytes(store.read_bytes()[:8192])
    else:
        store.unlink()
    if when == "before":
        sources = [RunSource(folder) for folder in folders]
    page = client(*sources).get("/")  # type: ignore[arg-type]
    assert page.status_code == 200
    rows = re.findall("<tr>.*?</tr>", page.text)
    told = {name: next(row for row in rows if f">{name}</a>" in row) for name in ("first", "second", "third")}
    assert [name for name, row in told.items() if "hard" in row] == ["second"]
    assert "2 of 2" in told["first"]
    assert "books" in told["second"]
