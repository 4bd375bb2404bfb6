"""A page as a browser shows it: pages of its print, its width at a width of the window."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")

ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--hide-scrollbars", "--virtual-time-budget=5000",
)  # fmt: skip

TIME_LIMIT_S = 180.0

MEASURE = """<script>addEventListener("load", function () {
  var frame = document.getElementById("page"), page = frame.contentDocument, width = frame.contentWindow.innerWidth;
  var beyond = Array.from(page.querySelectorAll("body *")).filter(function (e) {
    return e.getBoundingClientRect().right > width + 1 && !e.closest(".scroll table, pre, svg *"); });
  document.title = "measured " + page.documentElement.scrollWidth + " " + width + " " + beyond.length;
})</script>"""


def browser() -> str:
    """Path of a browser; skips the test where there is none."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no browser is installed: {', '.join(NAMES)}")
    return found


def printed_pages(page: Path, folder: Path) -> int:
    """Pages that a page is printed on."""
    target = folder / "print.pdf"
    _run(folder, "--no-pdf-header-footer", f"--print-to-pdf={target}", page.resolve().as_uri())
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", target.read_bytes()))


def width_px(text: str, window_px: int, folder: Path) -> tuple[int, int]:
    """Width that a page takes in a window, and how many of its elements reach beyond it."""
    around = folder / "around.html"
    frame = (
        f'<iframe id="page" style="width:{window_px}px;height:800px;border:0" srcdoc="{html.escape(text)}"></iframe>'
    )
    around.write_text(f"<!DOCTYPE html><html><body>{frame}{MEASURE}</body></html>", encoding="utf-8")
    shown = _run(folder, "--dump-dom", around.resolve().as_uri())
    found = re.search(r"measured (\d+) (\d+) (\d+)", shown.partition("</title>")[0])
    assert found, "the browser did not measure the page"
    assert int(found[2]) == window_px
    return int(found[1]), int(found[3])


def shown_page(page: Path, folder: Path, view: str = "") -> str:
    """What stands in a page when its scripts have come to rest, at an address that ends with `view`."""
    return _run(folder, "--dump-dom", page.resolve().as_uri() + view)


def _run(folder: Path, *arguments: str) -> str:
    command = [browser(), *ARGUMENTS, f"--user-data-dir={folder / 'profile'}", *arguments]
    try:
        made = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=TIME_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip(f"the browser did not answer within {TIME_LIMIT_S:g} s")
    return made.stdout
