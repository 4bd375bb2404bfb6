"""Words of plain G-code and LinuxCNC blocks: letters with numbers, and comments in parentheses or after ``;``."""

from __future__ import annotations

import re
from collections.abc import Set

from ebamcheck.nc.modal_groups import checked_block, refusal
from ebamcheck.nc.words import (
    NUMBER,
    Block,
    UnknownWord,
    WordError,
)

_WORD = re.compile(rf"\s*(?:(?P<letter>[A-Z])\s*(?P<number>{NUMBER})|(?P<bad>\S.*))")
_RUN = re.compile(
    r"\s*(?:PY(?:RUN)?|LOG\w*|PROBE\w*|ABORT)\s*,|\s*PYRELOAD|\s*PROBEOPEN|\s*PROBECLOSE|\s*LOGCLOSE",
    re.IGNORECASE,
)
"""Comments that LinuxCNC runs, beside those that only show something (interp_convert.cc, ``convert_comment``)."""
_COMMENT = re.compile(r"\(([^()]*)\)")

MOTIONS = frozenset(("G0", "G1", "G2", "G3"))
MODES = frozenset(
    {
        "G17", "G21", "G90", "G91.1", "G94", "G40", "G49", "G80", "G92.1", "G61", "G64",
        "G54", "G55", "G56", "G57", "M1",
    }
)  # fmt: skip
"""Modal words that are read. G18 to G20, G90.1, G91, G93 are refused: a program here has none of them."""
ENDS = frozenset(("M2", "M30"))
NUMBERS = frozenset("XYZIJRPQF")


def without_comments(text: str) -> tuple[str, list[str]]:
    """Return the code of a line, with blanks in place of its comments, and the comments.

    Raises
    ------
    WordError
        For a parenthesis without its other half, and for a comment that the control runs.
    """
    code, mark, tail = text.partition(";")
    comments = [found[1] for found in _COMMENT.finditer(code)]
    if comments:
        code = _COMMENT.sub(lambda found: " " * len(found[0]), code)
    for column, character in enumerate(code):
        if character in "()":
            raise WordError("a parenthesis without its other half", column)
    comments += [tail] if mark else []
    for comment in comments:
        if _RUN.match(comment):
            raise WordError(f"the control runs the comment {comment.strip()!r}", 0)
    return code, comments


def read_gcode_block(code: str, codes: Set[str], dialect: str) -> Block:
    """Split the upper-case text of a block, without number and comment, into its words.

    Raises
    ------
    UnknownWord
        For a word that is not of the language of `dialect`; `codes` are the G and M words known.
    WordError
        For a word given twice, or two of one modal group.
    """
    block = Block({}, {}, [])
    for found in _WORD.finditer(code):
        if found["bad"]:
            raise UnknownWord(f"unknown word {found['bad'].split()[0]!r}", found.start("bad"))
        letter, number = found["letter"], found["number"]
        column = found.start("letter")
        if letter in "GM":
            word = f"{letter}{float(number):g}"
            if word not in codes:
                raise UnknownWord(refusal(dialect, word), column)
            block.codes.append(word)
        elif letter not in NUMBERS:
            raise UnknownWord(refusal(dialect, code[column : found.end()]), column)
        elif letter in block.values:
            raise WordError(f"{letter} stands twice in one block", column)
        else:
            block.values[letter] = float(number)
    if len(block.codes) > 1:
        checked_block(dialect, block.codes, MOTIONS | {"G5"})
    return block
