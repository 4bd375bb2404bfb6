"""Make docs/map.md from the modules' first docstring lines: ``make map``."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = ("ebamcheck", "backends", "reference_models", "reports")

FOLDERS = {
    "ebamcheck": "The harness: what every room shares.",
    "reports/pictures": "The pictures of the README.",
}
"""Folders whose sentence is not the first line of their package."""

HEAD = """# Map of modules

Made by `make map` from the first docstring line of every module; ARCHITECTURE.md says how the rooms hang together.
"""


def sentence(module: Path) -> str:
    """Return the first paragraph of a module's docstring on one line; empty where there is none."""
    docstring = ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.split("\n\n")[0].split())


def folders() -> Iterator[tuple[str, str, list[Path]]]:
    """Every folder with modules: its path from the root, its sentence, its modules without the package's own."""
    for source in SOURCES:
        for folder in sorted({path.parent for path in (ROOT / source).rglob("*.py")}):
            name = folder.relative_to(ROOT).as_posix()
            package = folder / "__init__.py"
            said = FOLDERS.get(name) or (sentence(package) if package.exists() else "")
            yield name, said, [path for path in sorted(folder.glob("*.py")) if path != package]


def module_map() -> str:
    """Return docs/map.md."""
    parts = [HEAD]
    for name, said, modules in folders():
        items = "\n".join(f"- `{path.name}`: {sentence(path)}" for path in modules)
        parts.append(f"## `{name}/`\n\n{said}\n" + (f"\n{items}\n" if items else ""))
    return "\n".join(parts)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    (ROOT / "docs" / "map.md").write_text(module_map(), encoding="utf-8")
