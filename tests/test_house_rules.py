"""Sizes that the house keeps to: lines of a module, lines of a function, parameters of a kernel."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("ebamcheck", "backends", "reference_models", "reports", "benchmarks", "tests", "docs")
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))

LEAST_LINES, MOST_LINES = 60, 600
"""Lines of a module: as long as its idea."""

SHORT_MODULES = Path(__file__).with_name("short_modules.txt")
"""Modules of ``ebamcheck`` that have fewer. The list only gets shorter."""

MOST_BODY = 80
"""Lines of a function, without its head and docstring."""

MOST_PARAMETERS = 9
"""Parameters of a kernel, unless the comment above it says why there are more."""

REASON = re.compile(r"# \w+ parameters: \S")
"""How such a comment begins."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def functions() -> list[tuple[Path, str, Function]]:
    """Functions and methods of the house: file, place and code of each."""
    return [
        (path, f"{path.relative_to(ROOT).as_posix()}:{node.name}", node)
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, Function)
    ]


def body_lines(function: Function) -> int:
    """Lines of a function without its head and docstring."""
    rest = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return (rest[-1].end_lineno or 0) - rest[0].lineno + 1 if rest else 0


def is_kernel(function: Function) -> bool:
    return any(ast.unparse(one).split("(")[0].endswith("kernel") for one in function.decorator_list)


def parameters(function: Function) -> int:
    arguments = function.args
    return len(arguments.posonlyargs + arguments.args + arguments.kwonlyargs)


def is_told(path: Path, function: Function) -> bool:
    """Whether the comment above a kernel says why it has so many parameters."""
    lines = path.read_text().splitlines()
    first = min(one.lineno for one in function.decorator_list) - 2
    while lines[first - 1].startswith("#"):
        first -= 1
    return bool(REASON.match(lines[first]))


def test_there_is_something_to_measure():
    kernels = [f for _, _, f in functions() if is_kernel(f)]
    assert len(FILES) > 500
    assert len(kernels) > 150
    assert max(map(body_lines, kernels)) > 40
    assert max(map(parameters, kernels)) > MOST_PARAMETERS


def test_modules_are_short():
    long = {str(path.relative_to(ROOT)): path.read_text().count("\n") for path in FILES}
    assert {name: lines for name, lines in long.items() if lines > MOST_LINES} == {}


def test_no_module_is_shorter_than_an_idea_but_those_on_the_list():
    modules = (p for p in FILES if p.parts[len(ROOT.parts)] == "ebamcheck" and p.name != "__init__.py")
    short = {p.relative_to(ROOT).as_posix() for p in modules if p.read_text().count("\n") < LEAST_LINES}
    listed = set(SHORT_MODULES.read_text().split())
    assert short - listed == set(), "merge them into the module that they belong to"
    assert listed - short == set(), "take them off the list"


def test_functions_are_short():
    assert {place: lines for _, place, f in functions() if (lines := body_lines(f)) > MOST_BODY} == {}


def test_kernels_have_few_parameters_or_a_reason_beside_them():
    many = [(path, place, f) for path, place, f in functions() if is_kernel(f)]
    many = [found for found in many if parameters(found[2]) > MOST_PARAMETERS]
    assert {place for path, place, f in many if not is_told(path, f)} == set()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("# Ten parameters: a tuple costs 10 us a call.\n@kernel\ndef f(a): ...", True),
        ("# Ten parameters: a tuple costs 10 us a call,\n# as was measured.\n@kernel\ndef f(a): ...", True),
        ("# Fast.\n@kernel\ndef f(a): ...", False),
        ("x = 1\n@kernel\ndef f(a): ...", False),
    ],
)
def test_a_reason_is_the_comment_above_the_kernel(text, told, tmp_path):
    path = tmp_path / "m.py"
    path.write_text(f"import y\n\n{text}\n")
    function = next(node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, Function))
    assert is_told(path, function) is told


# -- circles -----------------------------------------------------------------------------------------


def imported(module: str, is_package: bool, text: str) -> Iterator[str]:
    """Names that a module imports, at its head or inside functions, relative ones made absolute; not those for type checkers."""
    waiting: list[ast.AST] = [ast.parse(text)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[
                : None if is_package and node.level == 1 else int(is_package) - node.level
            ]
            base = ".".join([*(above if node.level else []), *([node.module] if node.module else [])])
            yield from (f"{base}.{name.name}" for name in node.names)


def module_graph(files: dict[str, tuple[bool, str]]) -> dict[str, set[str]]:
    """For each module, given as whether it is a package and its text, the modules of `files` that it imports."""

    def found(name: str) -> str:
        """The module that has a name, or is it."""
        while name and name not in files:
            name = name.rpartition(".")[0]
        return name

    # A package names itself where it hands out what its modules have.
    return {
        name: {found(other) for other in imported(name, *file)} - {"", name if file[0] else ""}
        for name, file in files.items()
    }


def circles(graph: dict[str, set[str]]) -> set[frozenset[str]]:
    """Groups of modules each of which reaches the others of its group."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            if (name := waiting.pop()) not in seen:
                seen.add(name)
                waiting += graph[name]
        return seen

    within = {name: reached(name) for name in graph}
    return {
        frozenset(other for other in within[name] if name in within[other])
        for name in graph
        if name in within[name]
    }


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("import a.b, c", {"a.b", "c"}),
        ("from a.b import c, d as e", {"a.b.c", "a.b.d"}),
        ("def f():\n    from a import b", {"a.b"}),
        ("from . import b\nfrom .c import d\nfrom ..e import f", {"p.q.b", "p.q.c.d", "p.e.f"}),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import a\nelse:\n    import b", {"typing.TYPE_CHECKING", "b"}),
    ],
)  # fmt: skip
def test_imports_are_found_wherever_they_stand(text, names):
    assert set(imported("p.q.m", False, text)) == names


def test_relative_imports_of_a_package_begin_in_it():
    assert set(imported("p.q", True, "from .a import b\nfrom ..c import d")) == {"p.q.a.b", "p.c.d"}


def test_a_circle_is_found_and_a_chain_is_none():
    texts = {
        "a": "import b",
        "b": "def f():\n    from c import x",
        "c": "import a\nimport d",
        "d": "import e",
        "e": "",
    }
    assert circles(module_graph({name: (False, text) for name, text in texts.items()})) == {frozenset("abc")}


def test_no_module_imports_itself_by_way_of_others():
    files = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): (
            path.name == "__init__.py",
            path.read_text(),
        )
        for path in FILES
        if path.parts[len(ROOT.parts)] == "ebamcheck"
    }
    assert circles(module_graph(files)) == set()
