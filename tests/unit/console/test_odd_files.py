"""Whatever a path or an argument names, a command ends in one line and exit code 2 or 3: 1 means violations, always."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.contract.flight import Trace, pack_trace
from saflite.flight.autopilots.reference.describe import describe
from saflite.recorder.exports.aerialist import write_case

REFUSED, INFRASTRUCTURE = 2, 3

FILES: dict[str, tuple[str, list[str]]] = {
    "case.json": ("fly", []),
    "case.yaml": ("fly", []),
    "case.mcap": ("fly", []),
    "mission.plan": ("fly", []),
    "more.json": ("score", []),
    "flight.mcap": ("judge", []),
    "flight.trace": ("judge", []),
    "flight.ulg": ("judge", []),
    "flight.bin": ("judge", []),
    "flight.csv": ("judge", []),
    "again.mcap": ("replay", []),
    "again.json": ("replay", []),
    "campaign.toml": ("run", ["--out", "run"]),
    "mutants.toml": ("mutate", []),
    "module.py": ("list", ["targets", "--module"]),
    "module.toml": ("list", ["policies", "--module"]),
    "labels.csv": ("evaluate", ["logs", ".", "--labels"]),
    "policy.toml": ("judge", ["flight.trace", "--policy"]),
    "beside.json": ("judge", ["flight.trace", "--test-case"]),
}
"""Every command that takes a file, the file last."""

FOLDERS: dict[str, list[str]] = {
    "audit": [],
    "resume": [],
    "report": [],
    "replay": [],
    "artefacts": [],
    "watch": [],
    "export": ["--format", "csv"],
}
"""Every command that takes a run folder."""


def fifo(path: Path) -> None:
    os.mkfifo(path)


def endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**30)


def loop(path: Path) -> None:
    path.symlink_to(path)


def folder(path: Path) -> None:
    path.mkdir()


def dangling(path: Path) -> None:
    path.symlink_to("nothing")


ODD: tuple[Callable[[Path], None], ...] = (fifo, endless, huge, loop, folder, dangling)


def ends_in_a_line(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    code = main([str(word) for word in words])
    said = capsys.readouterr().err
    assert code in (REFUSED, INFRASTRUCTURE), (words, said)
    assert "fault of saflite itself" not in said, said
    assert "Traceback" not in said, said
    assert said.count("\n") <= 2, said  # a warning about the run may come first
    assert len(said) < 2_000, said
    return said


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    times = np.arange(0.0, 5.0, 0.05)
    signals = {name: (times + 1.0).astype("<f4").tobytes() for name in ("x_m", "y_m", "altitude_m")}
    (tmp_path / "flight.trace").write_bytes(pack_trace(Trace(step_s=0.05, signals=signals)))
    return tmp_path


@pytest.fixture
def run_dir(here: Path) -> Path:
    campaign = load_campaign("avoidance-m2")
    Store.create(here / "run", campaign, template(campaign), describe()).close()
    return here / "run"


@pytest.mark.parametrize("odd", ODD)
def test_a_file_that_is_none_is_refused_by_every_command(
    odd: Callable[[Path], None], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, (command, words) in FILES.items():
        path = here / odd.__name__ / name
        path.parent.mkdir(exist_ok=True)
        odd(path)
        before = path.name
        assert before in ends_in_a_line(capsys, command, *words, str(path)), command


@pytest.mark.parametrize("name", ["x" * 5_000, "x" * 300, "/".join("x" * 2_500), "\udcff", "a\nb\x1b[2J", ""])
def test_a_path_that_can_be_none_is_refused_by_every_command(
    name: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for file, (command, words) in FILES.items():
        said = ends_in_a_line(capsys, command, *words, f"{name}/{file}")
        assert "\x1b" not in said
    for command, words in FOLDERS.items():
        ends_in_a_line(capsys, command, name or "nothing", *words)
    for words in (["fly", "case.json"], ["report", "run"], ["run", "avoidance-m2"]):
        ends_in_a_line(capsys, *words, "--out", f"{name}/{'y' * 300}", "--json")


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("file", ["books.sqlite", "books.witness", "books.lock", "books.snapshot", "modules.json"])
def test_a_run_folder_with_something_else_in_it_is_told_of(
    odd: Callable[[Path], None], file: str, run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run_dir / file).unlink(missing_ok=True)
    odd(run_dir / file)
    for command, words in FOLDERS.items():
        if command == "resume" and file not in ("books.sqlite", "books.witness"):
            continue  # the run would go on
        code = main([command, str(run_dir), *words])
        said = capsys.readouterr()
        assert "Traceback" not in said.err + said.out
        assert "fault of saflite itself" not in said.err, said.err
        assert code in (0, REFUSED, INFRASTRUCTURE), (command, said.err)
        if file in ("books.sqlite", "books.witness") and command != "watch":
            assert code != 0 or "warning" in said.err, (command, said.err)


# ---- what may not be written ----------------------------------------------------------------------------------------


@contextmanager
def without_override() -> Iterator[None]:
    """Let the modes of files count for root, too: CAP_DAC_OVERRIDE is put aside, in this thread."""
    if os.geteuid() != 0:
        yield
        return
    libc = ctypes.CDLL(None, use_errno=True)
    head, data = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    assert libc.capget(head, data) == 0
    effective = data[0]
    data[0] = effective & ~(1 << 1)
    assert libc.capset(head, data) == 0
    try:
        yield
    finally:
        data[0] = effective
        assert libc.capset(head, data) == 0


def test_folders_that_take_no_files_are_unavailable(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    locked = here / "locked"
    locked.mkdir(mode=0o500)
    with without_override():
        for words in (
            ["mutate", "avoidance-m2", "--count", "1", "--out", "locked/cases"],
            ["run", "avoidance-m2", "--out", "locked/run"],
            ["keys", "init", "--keys", "locked/keys", "--host", "a"],
            ["evaluate", "logs", ".", "--text", "locked/text"],
            ["evaluate", "logs", ".", "--plot", "locked/x.svg"],
        ):
            said = ends_in_a_line(capsys, *words)
            assert "locked" in said
    assert list(locked.iterdir()) == []


def test_a_run_folder_that_became_read_only_is_told_of_and_stays_as_it_was(
    run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in run_dir.iterdir() if path.is_file()}
    for path in run_dir.iterdir():
        path.chmod(0o400 if path.is_file() else 0o500)
    run_dir.chmod(0o500)
    with without_override():
        for words in (["resume"], ["report"], ["export", "--format", "csv"], ["audit", "--rebuild"]):
            ends_in_a_line(capsys, words[0], str(run_dir), *words[1:])
        assert main(["audit", str(run_dir)]) == 0  # reading is all it takes
    assert {path: path.read_bytes() for path in run_dir.iterdir() if path.is_file()} == before


# ---- arguments and texts ---------------------------------------------------------------------------------------------

DIGITS = "9" * 400


@pytest.mark.parametrize(
    "words",
    [
        *(
            ["run", "avoidance-m2", "--out", "run", option, DIGITS]
            for option in ("--budget", "--workers", "--rng-seed")
        ),
        ["run", "avoidance-m2", "--out", "run", "--workers", "1000000000"],
        ["run", "avoidance-m2", "--out", "run", "--budget", "9" * 5_000],
        ["run", "avoidance-m2", "--out", "run", "--set", f"boxes_min={DIGITS}"],
        ["mutate", "avoidance-m2", "--rng-seed", DIGITS],
        ["mutate", "avoidance-m2", "--round", DIGITS],
        ["mutate", "avoidance-m2", "--count", DIGITS],
        ["fly", "nothing.json", "--wall-limit", "1e999"],
        ["replay", "nothing.json", "--times", DIGITS],
        ["score", "nothing.json", "--deadline", "nan"],
        ["control", "budget", DIGITS, "--run", "nothing"],
        ["control", "budget", "9" * 5_000],
        ["run", "avoidance-m2", "--out", "run", "--set", f"boxes_min={'9' * 5_000}"],
        ["run", "avoidance-m2", "--out", "run", "--set", f"boxes_min={'[' * 5_000}"],
        ["run", "avoidance-m2", "--out", "run", "--set", "boxes_min=1e999"],
        ["run", "avoidance-m2", "--out", "run", "--target-set", f"x={'9' * 5_000}"],
        ["run", "avoidance-m2", "--out", "run", "--target-set", f"x={'{a=' * 5_000}"],
        ["run", "avoidance-m2", "--out", "run", "--metrics", f"{'h' * 70}:9464"],
        ["watch", "nothing", "--from", DIGITS],
        ["keys", "init", "--host", "a", "--days", DIGITS],
        ["worker", "--join", "unixsock-stream//nobody", "--workers", DIGITS],
    ],
    ids=lambda words: " ".join(words)[:60],
)
def test_numbers_of_400_digits_are_refused(words: list[str], here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ends_in_a_line(capsys, *words)
    assert not (here / "run").exists()


def test_a_number_in_the_environment_that_no_machine_holds_is_refused(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_case(template(load_campaign("avoidance-m2")), here, "case")
    for number in ("9" * 5_000, "-1", "1e3", "nan", "\x1b[2J"):
        monkeypatch.setenv("SAFLITE_SNAPSHOTS_MAX", number)
        assert "\x1b" not in ends_in_a_line(capsys, "fly", "case.yaml")


def test_a_path_with_a_nul_in_a_file_is_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for key in ("run", "campaign", "keys", "modules"):
        value = '["a\\u0000b"]' if key == "modules" else '"a\\u0000b"'
        lines = {"campaign": '"avoidance-m2"', "run": '"runs/x"', key: value}
        (here / "farm.toml").write_text("".join(f"{name} = {one}\n" for name, one in lines.items()))
        ends_in_a_line(capsys, "up", "farm.toml")


@pytest.mark.parametrize(
    "endpoint",
    [
        *(
            "tcp/ä.example:7447",
            "tcp/host\n:7447",
            "tcp/h:99999",
            "tcp/h:0",
            "tls/[::1%eth0]:7447",
            "tcp/h:7447#iface=lo",
        ),
        *("unixsock-stream/\x1b[2J", "unixsock-stream/\udcff", "unixsock-stream/" + "é" * 3_000, "unixsock-stream/"),
        *("udp/h:1", "tcp/", "", "tcp/" + "h" * 5_000 + ":1", "quic/h:7447", "serial//dev/tty", "tls/h:7447?x=1;y"),
    ],
)
def test_endpoints_of_odd_characters_are_refused(endpoint: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (
        ["worker", "--insecure", "--join"],
        ["run", "avoidance-m2", "--out", "run", "--insecure", "--listen"],
        ["watch", "--insecure", "--campaign", "x", "--connect"],
    ):
        if not endpoint and words[0] != "worker":
            continue  # as if it was not given
        said = ends_in_a_line(capsys, *words, endpoint)
        assert "\x1b" not in said
    assert not (here / "run").exists()


def own_policy(formula: str) -> str:
    return (
        'id = "own"\ntitle = "t"\nsource = "s"\ninterestingness = "i"\n'
        f'formula = "{formula}"\nsignals = {{ altitude_m = "m" }}\n'
        '[[examples]]\nholds = true\nwhy = "above"\nduration_s = 3.0\nsignals = { altitude_m = 5 }\n'
        '[[examples]]\nholds = false\nwhy = "below"\nduration_s = 3.0\nsignals = { altitude_m = -5 }\n'
    )


@pytest.mark.parametrize(
    "formula",
    [
        "always (" + " and ".join(["altitude_m > 0"] * 450) + ")",
        "always (" + " and ".join(["altitude_m > 0"] * 20_000) + ")",
        "(" * 450 + "altitude_m > 0" + ")" * 450,
        "not " * 450 + "altitude_m > 0",
        "always[0:1e308] altitude_m > 0",
        "always[1e308:1e308] altitude_m > 0",
        "always[0:1e999] altitude_m > 0",
        f"always (altitude_m > {DIGITS})",
        f"always[0:{DIGITS}] (altitude_m > 0)",
        f"always (altitude_m > {'9' * 5_000}.5)",
        "always (altitude_m / 0.0 > 0)",
        "eventually[0:1e-320] altitude_m > 0",
        "\\u0000",
        "always (altitude_m > 1e-400)",
    ],
    ids=lambda text: text[:40],
)
def test_a_policy_of_any_size_is_judged_by_or_refused(
    formula: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "own.toml").write_text(own_policy(formula))
    code = main(["judge", "flight.trace", "--policy", "own.toml"])
    said = capsys.readouterr()
    assert "fault of saflite itself" not in said.err, said.err
    assert code in (0, 1, REFUSED, 4), said.err
    assert (code == REFUSED) == said.err.startswith("saflite: refused: ")


@pytest.mark.parametrize("part", ["examples", "terms", "signals", "constants"])
def test_a_policy_of_thousands_of_parts_is_refused_at_once(
    part: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, many = own_policy("always altitude_m > 0"), range(3_000)
    example = '[[examples]]\nholds = true\nwhy = "above"\nduration_s = 3.0\nsignals = { altitude_m = 5 }\n'
    values = {"terms": '"altitude_m > 0"', "signals": '"m"', "constants": "1.0"}
    table = "".join(f"name{number} = {values.get(part)}\n" for number in many)
    if part == "signals":
        text = text.replace('signals = { altitude_m = "m" }\n', "") + f'[signals]\naltitude_m = "m"\n{table}'
    else:
        text += example * 3_000 if part == "examples" else f"[{part}]\n{table}"
    (here / "own.toml").write_text(text + "#\n" * 50_000)
    assert "at most 1000" in ends_in_a_line(capsys, "judge", "flight.trace", "--policy", "own.toml")


def test_a_policy_whose_numbers_are_none_is_refused_before_a_run(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "own.toml").write_text(own_policy("always[0:1e308] altitude_m > 0"))
    ends_in_a_line(capsys, "run", "own.toml", "--out", "run")
    assert not (here / "run").exists()


@pytest.mark.parametrize("number", [DIGITS, "9" * 5_000, "1e999", "nan", "-1e308", "1e22"])
@pytest.mark.parametrize("key", ["budget_flights", "time_limit_s", "rng_seed"])
def test_campaign_files_with_numbers_no_machine_holds_are_refused(
    number: str, key: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "c.toml").write_text(f'name = "c"\nmission = "mission2"\npolicies = ["upright"]\n{key} = {number}\n')
    ends_in_a_line(capsys, "run", "c.toml", "--out", "run")
    assert not (here / "run").exists()


def test_cases_of_400_digits_are_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = msgspec.json.encode(template(load_campaign("avoidance-m2"))).decode()
    for place in ('"rng_seed":', '"time_limit_s":', '"home_lat_deg":'):
        head, _, rest = case.partition(place)
        (here / "case.json").write_text(f"{head}{place}{DIGITS}{rest[rest.index(',') :]}")
        ends_in_a_line(capsys, "fly", "case.json")
