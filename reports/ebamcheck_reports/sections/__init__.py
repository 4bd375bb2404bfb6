"""Sections of the HTML report, one module each: ``render(run) -> Markup``."""
