"""Words of NC blocks: the tokeniser of the reader, with line and column of what it does not understand."""

from __future__ import annotations

import re

from ebamcheck.controls.sinumerik.control import NAME
from ebamcheck.nc.modal_groups import checked_block, refusal
from ebamcheck.nc.words import NUMBER, Block, UnknownWord, WordError

_WORD = re.compile(
    rf"""\s*(?:
      (?P<list_address>PO\[[XYZ]\])\s*=\s*\((?P<list>[^()]*)\)   # PO[X]=(1,2,3)
    | (?P<letter>[A-Z])(?P<number>{NUMBER})(?![\d.]|\s*=)         # G1  X12.5, with blanks between them or without
    | (?P<name>[A-Z][A-Z0-9_]*)\s*=\s*(?P<value>{NUMBER})        # PL=1  CTOL=0.05  X=10
    | (?P<identifier>[A-Z_][A-Z0-9_]*)                           # BSPLINE  SOFT  MAIN_L0001
    | (?P<bad>\S.*)
    )""",
    re.VERBOSE,
)

_CODE = re.compile(r'[^;"]*(?:"[^"]*"[^;"]*)*')

G_CODES = frozenset(
    {
        "G0", "G1", "G2", "G3", "POLY", "BSPLINE",
        "G17", "G71", "G710", "G90", "G94", "G40", "D0", "TRAFOOF", "TRANS", "G54", "G55", "G56", "G57",
        "COMPOF", "RTLION", "SOFT", "BRISK", "FFWON", "FFWOF", "G60", "G64", "G641", "G642", "G643", "G644", "G645", "M1",
    }
)  # fmt: skip
"""Words that are read. Those that would bend the path (G18, G70, G91, G95 and others) are refused: a program has none."""

MOTIONS = frozenset({"G0", "G1", "G2", "G3", "POLY", "BSPLINE"})
"""The modal group of motions."""

ALONE = {
    "TRANS": "by itself it takes back every frame, else it sets one",
    "TRAFOOF": "it takes the work offset with it, and stands in a block of its own before that",
}
"""Words that stand by themselves in their block, and why."""

END_CODES = ("M30", "M17", "RET", "M2")
AXES = ("X", "Y", "Z")
NUMBERS = (*AXES, "F", "I", "J", "CR", "PL", "PW", "SD", "CTOL", "ADIS")
DEGREE = 3
"""Highest degree of a POLY block that is read; the control knows up to 5."""


def split_comment(text: str) -> tuple[str, str]:
    """Code and comment of a line: the comment begins at the first semicolon that stands in no message.

    A quotation mark without its other half stays in the code, which no block has.
    """
    end = _CODE.match(text).end()  # type: ignore[union-attr]
    return (text, "") if text[end : end + 1] == '"' else (text[:end], text[end + 1 :])


def read_block(code: str, rotary: tuple[str, ...] = ()) -> Block:
    """Split the upper-case text of a block, without number and comment, into its words; `rotary` are axes of a table.

    Raises
    ------
    UnknownWord
        For a word that is not of the language.
    WordError
        For a word given twice, two of one modal group, or a list that is no list of numbers.
    """
    block = Block({}, {}, [])
    for found in _WORD.finditer(code):
        kind = found.lastgroup
        if kind == "number":
            letter, digits = found.group("letter", "number")
            if letter in ("G", "M", "D"):
                _add_code(block, letter + (digits.lstrip("0") or "0"), found)
            else:
                _add_value(block, letter, digits, found, rotary)
        elif kind == "list":
            _add_list(block, found)
        elif kind == "value":
            _add_value(block, found["name"], found["value"], found, rotary)
        elif kind == "identifier":
            _add_code(block, found["identifier"], found)
        else:
            raise UnknownWord(f"unknown word {found['bad'].split()[0]!r}", found.start("bad"))
    if len(block.codes) > 1:
        checked_block(NAME, block.codes, MOTIONS)
    if len(block.codes) + len(block.values) + len(block.lists) > 1:
        for word in block.codes:
            if word in ALONE:
                raise WordError(f"{word} with other words: {ALONE[word]}", 0)
    return block


def _add_code(block: Block, word: str, found: re.Match[str]) -> None:
    if word not in G_CODES and word not in END_CODES:
        raise UnknownWord(refusal(NAME, word), found.end() - len(found[0].lstrip()))
    block.codes.append(word)


def _add_value(
    block: Block, address: str, digits: str, found: re.Match[str], rotary: tuple[str, ...]
) -> None:
    if address not in NUMBERS and address not in rotary:
        text = found[0].lstrip()
        raise UnknownWord(refusal(NAME, text), found.end() - len(text))
    if address in block.values:
        raise WordError(f"{address} stands twice in one block", found.start())
    block.values[address] = float(digits)


def _add_list(block: Block, found: re.Match[str]) -> None:
    address = found["list_address"]
    try:
        numbers = tuple(float(part) for part in found["list"].split(","))
    except ValueError:
        numbers = ()
    if not 1 <= len(numbers) <= DEGREE or address in block.lists:
        what = f"{found[0].strip()!r} is no single list of an end point and at most two coefficients"
        raise WordError(what, found.start("list_address"))
    block.lists[address] = numbers
