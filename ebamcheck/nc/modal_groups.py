"""Modal groups: sets of words of which one is in force at any time, and which of them hold at every motion of a program.

A program here establishes every group in its own first blocks, and may repeat a word, but changes none: a word of a
group other than the one wanted is a fault wherever it stands. Words that would bend the path as it is read (another
plane, other units, distances from the position before) are refused by the reader. The groups are those of the control.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from functools import cache

from ebamcheck.nc.control import Group, control
from ebamcheck.nc.words import WordError
from ebamcheck.settings.machine import MachineSettings


def offsets(first: int, last: int) -> tuple[str, ...]:
    """Words G`first` to G`last`."""
    return tuple(f"G{number}" for number in range(first, last + 1))


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


def checked_block(name: str, words: Sequence[str], motions: Set[str]) -> None:
    """Refuse two words of one group in a block, `motions` among them: a control stops there, with the beam as it is, or takes either.

    Raises
    ------
    WordError
        That names both.
    """
    seen: dict[str, str] = {}
    for word in words:
        group = group_of(name, word)
        kind = "motion" if word in motions else group.name if group else word
        if kind in seen:
            raise WordError(f"{seen[kind]} and {word} in one block: it takes one word of a group ({kind})", 0)
        seen[kind] = word
