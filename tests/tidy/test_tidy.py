"""The house rules that no linter checks: sizes, banned words, one place per impure thing."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from saflite.console.view import out
from saflite.contract.test_case import DEFAULT_TARGET

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "services" / "saflite"
LINES_MAX, FUNCTION_LINES_MAX = 400, 60

SOURCES = sorted(PACKAGE.rglob("*.py"))
NATIVE = sorted((PACKAGE / "flight").rglob("native/*.[ch]"))
SCRIPTS = sorted((ROOT / "scripts").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
SUFFIXES = (".py", ".c", ".h", ".toml", ".md", ".json", ".yaml", ".yml", ".sh", ".txt", ".service", "")

TIME = re.compile(r"time\.(time|monotonic|perf_counter|sleep)(_ns)?$|datetime\.(now|utcnow|today)$")
ENVIRONMENT = re.compile(r"os\.(environ|getenv)")
RANDOM = re.compile(r"random\.\w+$|np\.random\.(?!Generator$|PCG64$)\w+$|secrets\.\w+$|uuid\.uuid[14]$")
LEARNING = re.compile(r"msgspec\.convert$|msgspec\.(json|msgpack|toml|yaml)\.(Decoder|decode)$")
RULES = (
    ("how msgspec learns a type, which two threads at once die of", LEARNING, {"contract/wire.py"}),
    ("wall time", TIME, {"runtime/clock.py"}),
    ("the environment", ENVIRONMENT, {"contract/config.py"}),
    (
        "randomness",
        RANDOM,
        {
            *("contract/rng.py", "campaign/storage/sqlite.py", "evidence/folder.py", "runtime/on_ray.py"),
            "evidence/own_runs.py",  # a key
        },
    ),  # beside draws: the name of a run and of a folder, and a secret
)
MACHINE = re.compile(r"(?<![\w}*.)-])/(work|root|home)/\w|pip\.conf|index-url\s*=\s*http|artifactory", re.IGNORECASE)


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def texts() -> Iterator[Path]:
    for folder in ("services", "scripts", "tests", "deploy", ".ci", "schemas"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and path.suffix in SUFFIXES and "__pycache__" not in path.parts:
                yield path
    yield from (ROOT / name for name in (*PAGES, "pyproject.toml", ".pre-commit-config.yaml"))


def dotted(path: Path) -> Iterator[str]:
    """Yield the dotted names a file reads."""
    return (ast.unparse(node) for node in ast.walk(tree(path)) if isinstance(node, ast.Attribute))


def test_files_stay_small() -> None:
    sizes = {name(path): len(path.read_text().splitlines()) for path in SOURCES + NATIVE + SCRIPTS + TESTS}
    assert {place: lines for place, lines in sizes.items() if lines > LINES_MAX} == {}


def test_functions_stay_small() -> None:
    long = {}
    for path in SOURCES + SCRIPTS:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > FUNCTION_LINES_MAX:
                    long[f"{name(path)} {node.name}"] = lines
    assert long == {}


def test_compiled_functions_stay_small() -> None:
    long = {}
    for path in NATIVE:
        began = 0
        for number, line in enumerate(path.read_text().splitlines(), 1):
            if line == "{" or re.match(r"^[a-z].*\)\s*\{\s*$", line):
                began = number
            elif line == "}" and began:
                if number - began + 1 > FUNCTION_LINES_MAX:
                    long[f"{name(path)} line {began}"] = number - began + 1
                began = 0
    assert long == {}


def test_package_inits_are_docstrings_only() -> None:
    inits = [path for path in SOURCES if path.name == "__init__.py"]
    assert [name(path) for path in inits if len(tree(path).body) != 1 or not ast.get_docstring(tree(path))] == []


def test_time_environment_and_randomness_have_one_place() -> None:
    wrong = [
        f"{name(path)}: {what} by {word}"
        for path in SOURCES
        for what, rule, places in RULES
        if str(path.relative_to(PACKAGE)) not in places
        for word in sorted({word for word in dotted(path) if rule.match(word)})
    ]
    assert wrong == []


def test_what_is_handed_in_is_opened_by_the_one_reader_alone() -> None:
    """A file that others can write may be another one, a pipe, or cut, each time it is opened: what is looked at and
    what is read must be one opening."""
    opens = re.compile(r".*\.(open|read_bytes|read_text|mmap)$")
    readers = ("flight/logs/", "flight/competition/", "oracle/", "recorder/", "campaign/presets/")
    wrong = [
        f"{name(path)}: {word}"
        for path in SOURCES
        if str(path.relative_to(PACKAGE)).startswith(readers)
        for word in sorted({word for word in dotted(path) if opens.match(word)} - {"os.open"})
    ]
    assert wrong == []


def test_nobody_outside_a_targets_folder_knows_it_by_name() -> None:
    """The name of the default target stands once; what a target can do, its description says."""
    places = ("flight/autopilots/reference/", "simulator_worker/targets/")
    wrong = []
    for path in SOURCES:
        place = str(path.relative_to(PACKAGE))
        if place.startswith(places):
            continue
        for node in ast.walk(tree(path)):
            literal = isinstance(node, ast.Constant) and node.value == DEFAULT_TARGET
            module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            imported = any("autopilots.reference" in f"{module}.{one}" for one in names)
            if imported or (literal and place != "contract/test_case.py"):
                wrong.append(f"{name(path)} line {getattr(node, 'lineno', 0)}")
    assert wrong == []


def test_the_library_does_not_print() -> None:
    wrong = [
        f"{name(path)} line {node.lineno}"
        for path in SOURCES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]
    assert wrong == []


def test_no_path_or_host_of_one_machine() -> None:
    wrong = []
    for path in texts():
        if path == Path(__file__).resolve():
            continue
        content = path.read_text(errors="replace").splitlines()
        wrong += [
            f"{name(path)} line {number}: {line}" for number, line in enumerate(content, 1) if MACHINE.search(line)
        ]
    assert wrong == []


def test_default_tests_neither_sleep_nor_mock() -> None:
    rule = re.compile(r"time\.sleep$|mock\.|unittest\.mock")
    quiet = [path for path in TESTS if "live" not in path.parts and "pytest.mark.live" not in path.read_text()]
    assert [f"{name(path)}: {word}" for path in quiet for word in dotted(path) if rule.match(word)] == []


def test_each_command_says_in_one_line_what_it_does() -> None:
    for path in sorted((PACKAGE / "console" / "commands").glob("*.py")):
        assert out.summary_of(path).endswith((".", "`.")), name(path)


def test_the_pages_name_every_defect_scorer_and_command() -> None:
    from saflite.console.view.catalogue import items

    policies = (ROOT / "deploy" / "docs" / "policies.md").read_text()
    scorers = (ROOT / "deploy" / "docs" / "scorers.md").read_text()
    assert [item.name for item in items("defects") if f"`{item.name}`" not in policies] == []
    assert [item.name for item in items("scorers") if f"`{item.name}" not in scorers] == []


def test_links_of_the_pages_lead_somewhere() -> None:
    pages = [*(ROOT / name for name in PAGES), ROOT / "tests" / "README.md"]
    pages += sorted((ROOT / "deploy" / "docs").glob("*.md"))
    wrong = [
        f"{name(page)}: {link}"
        for page in pages
        for link in re.findall(r"\]\(([^)#]+)\)", page.read_text())
        if not link.startswith("http") and not (page.parent / link).exists()
    ]
    assert wrong == []
