"""No file of the package imports itself by way of others, not even for type checking."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "services" / "saflite"


def module_of(path: Path, package: Path) -> str:
    parts = (package.name, *path.relative_to(package).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def parsed(package: Path) -> dict[str, ast.Module]:
    return {module_of(path, package): ast.parse(path.read_text()) for path in sorted(package.rglob("*.py"))}


def outside_functions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what runs on import or is read by a type checker: all but the bodies of functions."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield child
            yield from outside_functions(child)


def imported(nodes: Iterator[ast.AST], known: dict[str, ast.Module]) -> Iterator[str]:
    """Yield the files of the package that import statements name: `from a import b` names a.b if that is a file."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in known else node.module for name in inner)


def import_graph(package: Path, *, within_functions: bool = False) -> dict[str, set[str]]:
    modules = parsed(package)
    return {
        name: set(imported(ast.walk(tree) if within_functions else outside_functions(tree), modules)) - {name}
        for name, tree in modules.items()
    }


def cycle(graph: dict[str, set[str]]) -> list[str]:
    """Return the files of one cycle, each importing the next; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as fault:
        return list(reversed(fault.args[1]))
    return []


@pytest.mark.parametrize("within_functions", [False, True])
def test_files_do_not_import_each_other_in_a_circle(within_functions: bool) -> None:
    assert cycle(import_graph(PACKAGE, within_functions=within_functions)) == []


def test_a_circle_is_found_wherever_it_closes(tmp_path: Path) -> None:
    package = tmp_path / "house"
    package.mkdir()
    (package / "__init__.py").write_text('"""A package."""\n')
    (package / "a.py").write_text("from house import b\n")
    (package / "b.py").write_text("from house.c import C\n")
    (package / "c.py").write_text("if TYPE_CHECKING:\n    from house.a import A\n")
    assert sorted(set(cycle(import_graph(package)))) == ["house.a", "house.b", "house.c"]
    (package / "c.py").write_text("def late():\n    import house.a\n")
    assert cycle(import_graph(package)) == []
    assert cycle(import_graph(package, within_functions=True)) != []
