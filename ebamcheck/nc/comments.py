"""Comments as every control takes them."""

from __future__ import annotations

LONGEST_COMMENT = 199
"""Characters of a comment line; a SINUMERIK takes blocks of under 200."""


def comment(text: str) -> str:
    """Return one comment line: ASCII, without the reserved characters ! and ?, cut to the length of a block."""
    allowed = "".join(c if c.isascii() and c.isprintable() and c not in "!?;" else "_" for c in text)
    return f"; {allowed}"[:LONGEST_COMMENT]
