"""The page with the data of a run in it, each layer deflated by itself and opened when it is shown."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from ebamcheck_viewer.contents import Contents

HEAD = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data: blob:; {policy}">
<title>{title}</title><style>{style}</style></head><body>
"""


def document(contents: Contents) -> str:
    """Build the whole page."""
    shipped = files("ebamcheck_viewer").joinpath("dist")
    script, style = (shipped.joinpath(name).read_text(encoding="utf-8") for name in ("viewer.min.js", "viewer.css"))
    policy = f"script-src {_hash(script)}; style-src {_hash(style)}"
    title = html.escape(f"ebamcheck: {contents.index['name']}")
    body = [
        HEAD.format(policy=policy, title=title, style=style),
        '<div id="app"></div>\n',
        _data("index", _json(contents.index)),
    ]
    body += [_data(name, text) for name, text in contents.blobs.items()]
    return "".join([*body, f"<script>{script}</script></body></html>\n"])


def _hash(text: str) -> str:
    """Source expression of a content security policy for one inline text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _json(value: Mapping[str, Any]) -> str:
    """JSON that can stand in a script element, whatever names are in it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _data(name: str, text: str) -> str:
    return f'<script type="text/plain" id="{name}">{text}</script>\n'
