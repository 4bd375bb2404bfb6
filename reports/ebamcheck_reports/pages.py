"""A self-contained HTML page in the style of the reports."""

from __future__ import annotations

from importlib.resources import files

from ebamcheck_reports.markup import Markup, element


def page(title: str, *body: Markup, style: str | Markup = "") -> str:
    """Build a page of its own; `style` comes after that of the reports."""
    css = Markup(files("ebamcheck_reports").joinpath("report.css").read_text(encoding="utf-8"))
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", css, Markup(style)),
    )
    return f"<!DOCTYPE html>\n{element('html', head, element('body', *body), lang='en')}\n"
