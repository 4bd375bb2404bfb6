"""Hook of mkdocs: pages link to pictures and tables in reports/, and the site carries along those that they link to."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]

LINKED = re.compile(r"\]\(\.\./(reports/[\w/.-]+)\)")
"""A link from a page to a file of the reports."""


def on_files(files: Files, config: Any) -> Files:
    """Add what pages link to. Tables go along as text, so that nothing in them has to be a page of the site."""
    for page in list(files.documentation_pages()):
        for name in LINKED.findall(page.content_string):
            if files.get_file_from_path(_in_site(name)) is None:
                files.append(File.generated(config, _in_site(name), abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, **unused: object) -> str:
    """Point the links at the copies within the site."""
    return LINKED.sub(lambda found: f"]({_in_site(found[1])})", markdown)


def _in_site(name: str) -> str:
    return f"{name}.txt" if name.endswith(".md") else name
