"""Recognising the templates of the machine profile in the text of a program, and what their codes do."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from string import Formatter

from ebamcheck.nc.codes import AUXILIARY, DWELL, SWITCHES, Action
from ebamcheck.nc.template_rules import Programmed
from ebamcheck.nc.words import NUMBER

RUNNING = ("set_power", "set_wire")
"""Templates that set values along a bead."""

ENDING = ("beam_off", "wire_stop")
"""Templates that may set a value to 0 at the end of a bead, before they switch off."""

_ZEROS = re.compile(r"\b([A-Z])0+(?=\d)")


@dataclass(frozen=True)
class StateChange:
    """What a block of a template does."""

    block: str
    """The block as it stands in the profile."""
    actions: tuple[tuple[str, float], ...]
    """Switches (NaN) and values that it sets, in the order of its codes."""
    before: tuple[str, ...] = ()
    """Blocks of the same template that come before one that switches."""
    running: bool = True
    """Whether the profile has the block in a template for values that change while beam and wire run, or as they end."""


class Templates:
    """All template blocks of a profile, as patterns of text."""

    def __init__(self, templates: Programmed) -> None:
        self._literal: dict[str, StateChange] = {}
        self._patterns: list[tuple[re.Pattern[str], StateChange]] = []
        self._memory: dict[str, StateChange | None] = {}
        running = {block for name in (*RUNNING, *ENDING) for block, _ in templates[name]}
        for name, blocks in templates.items():
            for i, (block, actions) in enumerate(blocks):
                switches = any(action.meaning in SWITCHES for action in actions)
                before = tuple(text for text, _ in blocks[:i]) if name in SWITCHES and switches else ()
                self._add(block, actions, before, block in running or not any(map(templates.get, RUNNING)))
        # A block that switches is looked for before one that fits the same text and does not.
        self._patterns.sort(key=lambda entry: not any(name in SWITCHES for name, _ in entry[1].actions))

    def _add(self, block: str, actions: tuple[Action, ...], before: tuple[str, ...], running: bool) -> None:
        done = tuple((_event(action), action.number) for action in actions if action.meaning != AUXILIARY)
        known = tuple((name, float("nan") if number is None else number) for name, number in done)
        change = StateChange(block, known, before, running)
        plain = _without_zeros(block)
        if "{" not in plain:
            self._literal.setdefault(plain, change)
            return
        self._patterns.append((re.compile("".join(_pattern_parts(plain)), re.IGNORECASE), change))

    def find(self, code: str) -> StateChange | None:
        """Return what the block does, if it is of a template; words set apart by any number of blanks, M60 written M060."""
        if code not in self._memory:
            self._memory[code] = self._search(_without_zeros(" ".join(code.split())))
        return self._memory[code]

    def _search(self, code: str) -> StateChange | None:
        if code in self._literal:
            return self._literal[code]
        for pattern, change in self._patterns:
            found = pattern.fullmatch(code)
            if found:
                filled = {group.rsplit("__", 1)[0]: float(text) for group, text in found.groupdict().items()}
                actions = [(name, filled.pop(name, value)) for name, value in change.actions]
                return StateChange(change.block, (*actions, *filled.items()), change.before, change.running)
        return None


def _without_zeros(block: str) -> str:
    """A block whose codes have no zeros before their numbers."""
    return _ZEROS.sub(r"\1", block)


def _event(action: Action) -> str:
    """Name of the event: what is filled in, else what the code means."""
    return action.placeholder if action.meaning == DWELL and action.placeholder else action.meaning


def _pattern_parts(block: str) -> Iterator[str]:
    for count, (literal, name, _spec, _conversion) in enumerate(Formatter().parse(block)):
        yield re.escape(literal)
        if name is not None:
            yield f"(?P<{name}__{count}>{NUMBER})"
