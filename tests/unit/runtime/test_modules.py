"""Modules from outside: known by what they offer, refused in one line, found again by resume and replay."""

from __future__ import annotations

import os
import py_compile
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.contract import modules
from saflite.contract.config import Campaign, StrategyConfig
from saflite.contract.errors import Refused
from saflite.contract.ids import digest
from saflite.contract.test_case import Target
from saflite.mutator.registry import load_strategy, options_of, strategy_names
from saflite.oracle.policy import POLICIES_DIR, load_policy
from saflite.runtime import run_modules
from saflite.scorer_pool.registry import check_label, model_names
from saflite.simulator_worker.registry import describe_target, load_target, target_names

POLICY = "policy own-upright"
TARGET = """
from saflite.contract.target_info import TargetInfo
def describe():
    return TargetInfo(name="cart", build="1", repeats="bitwise", inputs=(), signals=("x_m",))
def check(test_case): pass
def open(slot): pass
"""
STRATEGY = '''"""Proposes nothing at all, at great length, so that its text is long enough."""
class Strategy:
    proposes, options = "stimuli", {}
    def tell(self, outcomes): pass
    def ask(self, count, rng): return []
'''
SCORER = """
class Model:
    def __init__(self, argument, tools): pass
    def score(self, job): pass
    def warm(self, cancelled): pass
    def close(self): pass
"""


@pytest.fixture(autouse=True)
def own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place for the key that marks this user's runs."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def files(tmp_path: Path) -> Iterator[list[Path]]:
    """One module of each kind, all of one stem where they may be."""
    policy = (POLICIES_DIR / "upright.toml").read_text().replace('id = "upright"', 'id = "own-upright"')
    texts = {"cart.py": TARGET, "nothing.py": STRATEGY, "flat.py": SCORER, "cart.toml": policy}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    yield [tmp_path / name for name in texts]
    modules.forget()


def test_each_kind_is_found_by_what_the_file_offers(files: list[Path]) -> None:
    found = modules.use(files)
    kinds = [("target", "cart"), ("strategy", "nothing"), ("scorer", "flat"), ("policy", "own-upright")]
    assert [(module.kind, module.name) for module in found] == kinds
    assert "cart" in target_names()
    assert describe_target("cart").build == "1"
    assert load_target("cart").describe() == describe_target("cart")
    assert "nothing" in strategy_names()
    assert load_strategy("nothing").proposes == "stimuli"
    assert options_of("nothing") == {}
    assert "flat" in model_names()
    check_label("flat")
    assert load_policy("own-upright").id == "own-upright"
    modules.forget()
    assert "cart" not in target_names()
    assert "nothing" not in strategy_names()
    assert "flat" not in model_names()


def test_the_keyboard_interrupts_a_module_as_ever(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("raise KeyboardInterrupt")
    for _ in range(2):  # nothing is left of the first try
        with pytest.raises(KeyboardInterrupt):
            modules.use([tmp_path / "a.py"])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.py", "x = 1", "class Strategy"),
        ("a.py", "import no_such_package", "ModuleNotFoundError"),
        ("a.py", "import sys\nsys.exit(0)", "expected Python that runs, got SystemExit: 0"),
        ("a.py", "raise GeneratorExit", "expected Python that runs, got GeneratorExit"),
        ("a.py", "class Own(BaseException): pass\nraise Own('a\\nb')", "expected Python that runs, got Own: a"),
        ("a.py", "def describe(): pass", "target with describe, check, open, got one without check, open"),
        ("a.py", "class Strategy:\n    proposes, options = 'stimuli', {}", "without tell, ask"),
        ("a.py", "class Model:\n    pass", "without score, warm, close"),
        ("a.toml", "a = 1", "an id and a formula"),
        ("a.toml", "a = ", "TOML"),
        ("a.txt", "hello", "Python file"),
    ],
)
def test_what_is_no_module_is_refused_in_one_line(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(Refused, match=said) as refusal:
        modules.use([tmp_path / name])
    assert "\n" not in str(refusal.value)
    with pytest.raises(Refused, match="a readable file"):
        modules.use([tmp_path / "gone.py"])


def test_compiled_code_beside_a_file_is_not_run_in_its_place(tmp_path: Path) -> None:
    """It counts as that of the file if size and second are the same, whoever made it."""
    file = tmp_path / "cart.py"
    file.write_text(TARGET.replace('build="1"', 'build="2"'))
    py_compile.compile(str(file), doraise=True)
    made_s = file.stat().st_mtime
    file.write_text(TARGET)
    os.utime(file, (made_s, made_s))
    modules.use([file])
    assert describe_target("cart").build == "1"


def test_a_run_finds_its_modules_again_and_goes_on_with_its_copy_of_changed_ones(
    files: list[Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run_dir = tmp_path / "run"
    run_dir.mkdir()
    used = modules.use(files)
    run_modules.note(run_dir, used)
    modules.forget()
    assert run_modules.use(run_dir) == used
    assert "cart" in target_names()
    files[0].write_text(TARGET.replace('build="1"', 'build="2"'))
    files[1].unlink()
    for _ in range(2):  # a second time after what was used is noted again
        modules.forget()
        kept = run_modules.use(run_dir)
        run_modules.note(run_dir, kept)
        assert [(one.key, one.digest) for one in kept] == [(one.key, one.digest) for one in used]
        assert describe_target("cart").build == "1"
        assert load_strategy("nothing").proposes == "stimuli"
    assert "cart.py has changed" in caplog.text
    assert "nothing.py has gone" in caplog.text
    again = run_modules.use(run_dir, [files[0]])
    assert {module.name for module in again} == {module.name for module in used}
    assert describe_target("cart").build == "2"


def test_a_run_that_was_moved_brings_its_modules_and_says_when_they_are_damaged(
    files: list[Path], tmp_path: Path
) -> None:
    run_dir, moved = tmp_path / "run", tmp_path / "elsewhere"
    run_dir.mkdir()
    run_modules.note(run_dir, modules.use(files))
    modules.forget()
    run_dir.rename(moved)
    for file in files:
        file.unlink()
    run_modules.use(moved)
    assert describe_target("cart").build == "1"
    (copy,) = (moved / run_modules.FOLDER).rglob("cart.py")
    copy.write_text("x = 1")
    modules.forget()
    with pytest.raises(Refused, match=r"no such file, and no copy in modules/.*--module"):
        run_modules.use(moved)


def test_a_campaign_needs_its_target_and_strategy_and_all_scorers(files: list[Path], tmp_path: Path) -> None:
    run_modules.note(tmp_path, modules.use(files))
    own = Campaign(name="c", target=Target(name="cart"), strategy=StrategyConfig(name="pgfuzz"))
    assert [module.key for module in run_modules.needed(tmp_path, own)] == ["target cart", "scorer flat", POLICY]


def test_a_run_without_modules_has_none(tmp_path: Path) -> None:
    run_modules.note(tmp_path, ())
    assert run_modules.use(tmp_path) == ()
    (tmp_path / run_modules.FILE).write_text("{")
    with pytest.raises(Refused, match="list of modules"):
        run_modules.use(tmp_path)


KEY = Path("saflite/own-runs.key")


@pytest.mark.parametrize(
    "damage",
    [
        "rm data/saflite/own-runs.key",  # as any other user has none, or another
        "head -c 32 /dev/zero > data/saflite/own-runs.key",
        "head -c 31 data/saflite/own-runs.key > k; chmod 600 k; mv k data/saflite/own-runs.key",
        "chmod 644 data/saflite/own-runs.key",
        "mv data/saflite/own-runs.key k; ln -s ../../k data/saflite/own-runs.key",
        "rm received/modules.mark",
        "rm received/modules.mark; mkfifo received/modules.mark",
        "echo > received/modules.mark",
        "head -c 64 /dev/zero | tr '\\0' 0 > received/modules.mark",
        "echo ' ' >> received/modules.json",
    ],
)
def test_code_in_a_run_of_somebody_else_is_not_run_unless_it_is_named(
    damage: str, files: list[Path], tmp_path: Path
) -> None:
    run_dir = tmp_path / "received"
    run_dir.mkdir()
    run_modules.note(run_dir, modules.use(files))
    modules.forget()
    assert len(run_modules.use(run_dir)) == len(files)
    modules.forget()
    subprocess.run(damage, shell=True, cwd=tmp_path, check=True)
    with pytest.raises(Refused, match=r"--module .*modules/.*/cart\.py") as refused:
        run_modules.use(run_dir)
    assert "\n" not in str(refused.value)
    assert "cart" not in target_names()
    assert len(run_modules.use(run_dir, files[:3])) == len(files)  # all that is code is named


def test_the_key_is_this_users_alone(files: list[Path], tmp_path: Path, own_home: Path) -> None:
    run_modules.note(tmp_path, modules.use(files))
    assert (own_home / KEY).stat().st_mode & 0o777 == 0o600
    assert [path.name for path in (own_home / KEY).parent.iterdir()] == [KEY.name]


def test_a_module_that_is_replaced_after_it_was_looked_at_is_not_run(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was read once to be compared with what the run was made with, and again to be run."""
    run_dir, path, ran = tmp_path / "run", files[0], tmp_path / "ran"
    run_dir.mkdir()
    run_modules.note(run_dir, modules.use([path]))
    looked_at, content = run_modules._is, path.read_bytes()

    def replaced(place: Path, module: modules.Outside) -> bool:
        same = looked_at(place, module)
        path.write_bytes(content + f"\nopen({str(ran)!r}, 'w')\n".encode())
        return same

    monkeypatch.setattr(run_modules, "_is", replaced)
    with pytest.raises(Refused, match="the content that it had when it was looked at, got another"):
        run_modules.use(run_dir)
    assert not ran.exists()


def test_the_digest_of_a_module_is_that_of_what_was_run(tmp_path: Path) -> None:
    """One that changes its own file while it begins was told by what it left there."""
    path = tmp_path / "changing.py"
    text = "from pathlib import Path\nPath(__file__).write_text('another')\nclass Model:\n score = warm = close = 1\n"
    path.write_text(text)
    (told,) = modules.use([path])
    assert told.digest == digest(text.encode())


def test_a_policy_of_somebody_else_is_data(files: list[Path], tmp_path: Path) -> None:
    run_dir = tmp_path / "received"
    run_dir.mkdir()
    run_modules.note(run_dir, modules.use(files[3:]))
    modules.forget()
    (run_dir / run_modules.MARK).unlink()
    assert [module.key for module in run_modules.use(run_dir)] == [POLICY]
