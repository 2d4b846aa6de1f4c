"""Whatever path or text is handed in: read whole, or refused in one line, in bounded time and memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saflite.console.view.dashboard import access
from saflite.contract import outside
from saflite.contract.errors import Refused
from saflite.contract.plain import argument
from saflite.runtime import webhook


def test_a_file_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x\r\ny\n")
    assert outside.read_bytes(tmp_path / "a", "file", 5) == b"x\r\ny\n"
    assert outside.read_text(tmp_path / "a", "file") == "x\ny\n"
    (tmp_path / "link").symlink_to(tmp_path / "a")
    assert outside.check_file(tmp_path / "link", "file") == tmp_path / "link"


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o660, 0o602, 0o610, 0o601])
def test_a_file_with_a_secret_is_refused_where_others_can_open_it(mode: int, tmp_path: Path) -> None:
    path, link = tmp_path / "a secret", tmp_path / "link"
    path.write_text("operator 0123456789abcdef\n")
    link.symlink_to(path)
    read: tuple[Callable[[Path], object], ...] = (access.read_tokens, webhook.read_secret)
    for reader in read:
        for name in (path, link):
            path.chmod(mode)
            with pytest.raises(Refused, match=rf"{name}.*mode 0600.*others.*chmod 600 {argument(name)}"):
                reader(name)
            for private in (0o600, 0o400):
                path.chmod(private)
                assert reader(name)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_file_with_a_secret_that_another_user_put_there_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_text("operator 0123456789abcdef\n")
    path.chmod(0o600)
    os.chown(path, 12345, -1)
    for reader in (access.read_tokens, webhook.read_secret):
        with pytest.raises(Refused, match="one of user 12345"):
            reader(path)


@pytest.mark.parametrize("text", [r'{"a": "\ud800"}', r'{"\udfff": 1}', r'[["x", {"a": ["\ud83d"]}]]'])
def test_half_a_pair_of_surrogates_is_refused(text: str) -> None:
    with pytest.raises(Refused, match="surrogates"):
        outside.parse_json(text, "test case", "file")
    assert outside.parse_json(r'"\ud83d\ude00"', "test case", "file") == "\U0001f600"


def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    names = ["pipe", "zero", "dangling", "loop", "", "none", "x" * 5000, "nul\0"]
    for name in names:
        for read in (outside.read_text, outside.check_file):
            with pytest.raises(Refused) as refused:
                read(tmp_path / name, "test case")
            assert "\n" not in str(refused.value)
            assert len(str(refused.value)) < 500


def test_too_large_or_no_text_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "big").open("wb") as file:
        file.truncate(10 * 2**30)
    for read in (outside.read_text, outside.check_file):
        with pytest.raises(Refused, match="at most"):
            read(tmp_path / "big", "log")
    (tmp_path / "latin").write_bytes(b"\xff\xfe")
    with pytest.raises(Refused, match="UTF-8"):
        outside.read_text(tmp_path / "latin", "policy")


@pytest.mark.parametrize(
    "text",
    [
        *("x = nan", "x = inf", "x = -1e999", f"x = {'9' * 400}", f"x = {'9' * 5000}", "x = ", "x = 1\nx = 2"),
        *(f"x = {'[' * depth}{']' * depth}" for depth in (33, 400, 100_000)),
        f"[{'.'.join('a' * 40)}]",
        *(f"{key} = 1" for key in (".".join("a" * 100_000), " . ".join(["'a'", '"b.c"'] * 50_000))),
        f"x = {{ {'.'.join('a' * 100_000)} = 1 }}",
    ],
)
def test_toml_that_no_machine_should_hold_is_refused(text: str) -> None:
    with pytest.raises(Refused):
        outside.parse_toml(text, "campaign", "file")


@pytest.mark.parametrize("text", ["NaN", "[1e999]", "9" * 400, "9" * 5000, "[" * 100_000 + "]" * 100_000, "{", ""])
def test_json_that_no_machine_should_hold_is_refused(text: str) -> None:
    with pytest.raises(Refused):
        outside.parse_json(text, "test case", "file")


@given(st.text())
def test_no_text_ends_in_a_traceback(text: str) -> None:
    for parse in (outside.parse_toml, outside.parse_json):
        with suppress(Refused):
            outside.check_plain(parse(text, "file", "here"), "file", "here")


@pytest.mark.parametrize("part", ["x", "-", "a ", "a.b ", "'", "\"'", "' ", "x" * 999 + " ", "a." * 31 + "b ", "[a]\n"])
def test_toml_takes_time_with_its_length_alone(part: str) -> None:
    text = part * (200_000 // len(part))
    began_s = time.process_time()
    with suppress(Refused):
        outside.parse_toml(text, "campaign file", "file")
    assert time.process_time() - began_s < 5.0, "measured: under 0.5 s"


def test_a_table_takes_time_with_its_length_alone() -> None:
    """Half a million short rows below half a million heads would have been filled up to 250 thousand million fields."""
    text = "\n".join(["a," * 500_000, *["1"] * 500_000])
    with pytest.raises(Refused, match="at most 1000 columns, got 500001"):
        outside.parse_table(text, "labels", "file")
    rows = outside.parse_table("\n".join([",".join(map(str, range(1000))), "1", "2"]), "labels", "file")
    assert [len(row) for row in rows] == [1000, 1000]
    with pytest.raises(Refused, match="at most 4194304 fields, got 5000 rows of 1000"):  # 10 KB, and 4 MB took 80 GB
        outside.parse_table("\n".join([",".join(map(str, range(1000))), *["1"] * 5000]), "labels", "file")
