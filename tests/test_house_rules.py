"""Rules of the house: sizes of modules, functions and kernels, and no circle of imports."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("ebamcheck", "backends", "reference_models", "reports", "benchmarks", "tests", "docs")
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
LEAST_LINES, MOST_LINES = 60, 600  # Lines of a module: as long as its idea
# Modules of ``ebamcheck`` that have fewer. The list only gets shorter.
SHORT_MODULES = Path(__file__).with_name("short_modules.txt")
MOST_BODY = 80  # Lines of a function, without its head and docstring
MOST_PARAMETERS = 9  # Parameters of a kernel, unless the comment above it says why there are more
REASON = re.compile(r"# \w+ parameters: \S")  # How such a comment begins

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


def test_modules_are_as_long_as_an_idea():
    lines = {p.relative_to(ROOT).as_posix(): p.read_text().count("\n") for p in FILES}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}
    modules = {n: c for n, c in lines.items() if n.startswith("ebamcheck/") and not n.endswith("__init__.py")}
    short = {name for name, count in modules.items() if count < LEAST_LINES}
    listed = set(SHORT_MODULES.read_text().split())
    assert short - listed == set(), "merge them into the module that they belong to"
    assert listed - short == set(), "take them off the list"


def test_functions_are_short():
    assert len(functions()) > 3000
    assert {place: lines for _, place, f in functions() if (lines := body_lines(f)) > MOST_BODY} == {}


def test_kernels_have_few_parameters_or_a_reason_beside_them():
    kernels = [found for found in functions() if is_kernel(found[2])]
    many = [found for found in kernels if parameters(found[2]) > MOST_PARAMETERS]
    assert len(kernels) > 100
    assert many
    assert {place for path, place, f in many if not is_told(path, f)} == set()


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
            up = None if is_package and node.level == 1 else int(is_package) - node.level
            above = module.split(".")[:up] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{name.name}" for name in node.names)


def test_no_module_imports_itself_by_way_of_others():
    files = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in FILES
        if path.is_relative_to(ROOT / "ebamcheck")
    }

    def module_of(name: str) -> str:
        while name and name not in files:
            name = name.rpartition(".")[0]
        return name

    graph = {}
    for name, path in files.items():
        is_package = path.name == "__init__.py"
        found = {module_of(other) for other in imported(name, is_package, path.read_text())}
        # A package names itself where it hands out what its modules have.
        graph[name] = found - {"", name if is_package else ""}
    assert sum(map(len, graph.values())) > 1000
    TopologicalSorter(graph).prepare()  # a circle raises, and is named
