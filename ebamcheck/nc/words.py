"""Words of NC blocks: the table of a control's language, its blocks taken apart, and the modal groups that words belong to.

Of a modal group one word is in force at any time. A program establishes every group in its own first blocks, and changes none: a
word of a group other than the one wanted is a fault. Words that would bend the path as it is read are refused by the reader."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cache

from ebamcheck.nc.control import Group, control
from ebamcheck.settings.machine import MachineSettings

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
SKIP = re.compile(r"\s*/\d?\s*")  # Before a block that is skipped where the operator has chosen so
SKIPPED = "may be skipped"  # Event of such a block, where it does anything
MOST_OF_A_LIST = 3  # Numbers of a list: an end point, and coefficients of t^2 and t^3


@dataclass(frozen=True)
class Dialect:
    """The language of a control, as a table; see :class:`ebamcheck.nc.reader.Reader` for what its programs do."""

    name: str  # Of the control, whose modal groups its words belong to
    motions: Mapping[str, int]  # Words of motion, and the kind of each (:mod:`ebamcheck.nc.motions`)
    codes: frozenset[str]  # Other words without a value
    ends: frozenset[str]  # Those that end a program
    addresses: frozenset[str]  # Words with a value, beside the rotary axes of a machine
    # One word in capitals. The last of its groups says what it is: ``number`` behind a ``letter``, ``value`` behind a ``name``, ``list``
    # behind a ``list_address``, ``identifier``, or ``bad``.
    word: re.Pattern[str]
    code_letters: str = "GM"  # Letters whose numbers are no values
    code_number: Callable[[str], str] | None = None  # How such a number is told; None: without first zeros
    # The number before a block; its group is the digits.
    block_number: re.Pattern[str] = re.compile(r"\s*N(\d+)(?![\d.])\s*", re.IGNORECASE)
    radius: str = "R"  # How the radius of an arc is given
    # Pattern of the block that most curves of its programs are, in the spelling of most posts; its groups are numbers, for
    # :meth:`~ebamcheck.nc.reader.Reader.run_curve`. Empty: none.
    curve: str = ""
    message: re.Pattern[str] | None = None  # A block that only says something to the operator
    alone: Mapping[str, str] = field(default_factory=dict)  # Words that stand alone in their block, and why
    unused: str = ""  # Addresses that a block without an axis cannot use, in words; empty: those there


@dataclass(slots=True)
class Block:
    """One block: its values by address, and its words without value in order."""

    values: dict[str, float]
    lists: dict[str, tuple[float, ...]]
    codes: list[str]


class WordError(Exception):
    """A word that makes no sense where it stands; columns count from 0."""

    def __init__(self, what: str, column: int) -> None:
        super().__init__(what)
        self.what = what
        self.column = column


class UnknownWord(WordError):
    """A word outside the language; the interpreter may still know the block as a template or a call."""


def read_block(code: str, dialect: Dialect, rotary: Collection[str] = ()) -> Block:
    """Split the upper-case text of a block, without number and comment, into its words; `rotary` are axes of a table.
    :class:`UnknownWord` is one that is not of the language; a word given twice, two of one modal group, or no list is a
    :class:`WordError`."""
    block = Block({}, {}, [])
    for found in dialect.word.finditer(code):
        kind, text = found.lastgroup, found[0].lstrip()
        column, word, address, value = found.end() - len(text), "", "", ""
        if kind == "bad":
            raise UnknownWord(f"unknown word {text.split()[0]!r}", column)
        if kind == "list":
            try:
                numbers = tuple(float(part) for part in found["list"].split(","))
            except ValueError:
                numbers = ()
            if not 1 <= len(numbers) <= MOST_OF_A_LIST or found["list_address"] in block.lists:
                what = f"{text.strip()!r} is no single list of an end point and at most two coefficients"
                raise WordError(what, column)
            block.lists[found["list_address"]] = numbers
            continue
        if kind == "number":
            address, value = found.group("letter", "number")
            if address in dialect.code_letters:
                own = dialect.code_number
                word = address + (own(value) if own else value.lstrip("0") or "0")
        elif kind == "value":
            address, value = found.group("name", "value")
        else:
            word = found["identifier"]
        if word:
            if word not in dialect.codes and word not in dialect.motions and word not in dialect.ends:
                raise UnknownWord(refusal(dialect.name, word), column)
            block.codes.append(word)
        elif address not in dialect.addresses and address not in rotary:
            raise UnknownWord(refusal(dialect.name, text), column)
        elif address in block.values:
            raise WordError(f"{address} stands twice in one block", column)
        else:
            block.values[address] = float(value)
    if len(block.codes) > 1:
        # Of two words of one group a control takes either, or stops there with the beam as it is.
        seen: dict[str, str] = {}
        for one in block.codes:
            group = group_of(dialect.name, one)
            kind = "motion" if one in dialect.motions else group.name if group else one
            if kind in seen:
                what = f"{seen[kind]} and {one} in one block: it takes one word of a group ({kind})"
                raise WordError(what, 0)
            seen[kind] = one
    if len(block.codes) + len(block.values) + len(block.lists) > 1:
        for word in block.codes:
            if word in dialect.alone:
                raise WordError(f"{word} with other words: {dialect.alone[word]}", 0)
    return block


@cache
def _index(name: str) -> Mapping[str, Group]:
    return {word: group for group in control(name).groups for word in group.words}


def group_of(name: str, word: str) -> Group | None:
    """The group that a word of a control belongs to; None for a word of no group."""
    return _index(name).get(word)


def wanted_words(name: str, machine: MachineSettings) -> dict[str, str]:
    """Word of each group that is to hold at every motion, by the group's name."""
    found = ((group_of(name, word), word) for word in control(name).words(machine))
    return {group.name if group else word: word for group, word in found}


def refusal(name: str, word: str) -> str:
    """What there is to say of a word that is not read: its group, where it has one."""
    letters = word.rstrip("0123456789.+-")
    group = group_of(name, word) or group_of(name, letters)
    return f"unknown word {word!r}" + (f": {group.name} may not change in a program" if group else "")
