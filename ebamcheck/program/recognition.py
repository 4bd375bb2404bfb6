"""Recognising the beam and wire templates of the machine profile in the text of a program."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from string import Formatter

from ebamcheck.errors import SettingsError
from ebamcheck.program.words import NUMBER

SWITCHES = ("beam_on", "beam_off", "wire_start", "wire_stop")
"""Templates whose last block changes the state of the beam or the wire."""


@dataclass(frozen=True)
class StateChange:
    """What a block of a template does."""

    switches: tuple[str, ...]
    """Of :data:`SWITCHES`; empty for a block that only prepares."""
    values: tuple[tuple[str, float], ...]
    """Placeholders and the numbers found in their places."""


class Templates:
    """All template blocks of a profile, as patterns of text."""

    def __init__(self, templates: Mapping[str, tuple[str, ...]]) -> None:
        self._literal: dict[str, StateChange] = {}
        self._patterns: list[tuple[re.Pattern[str], tuple[str, ...]]] = []
        self._memory: dict[str, StateChange | None] = {}
        ends: dict[str, str] = {}
        for name, lines in templates.items():
            blocks = [code for code in map(_code, lines) if code]
            if name in SWITCHES:
                if not blocks:
                    raise SettingsError(
                        f"machine.{name} has no block: its state could not be told from the text"
                    )
                if blocks[-1] in ends:
                    raise SettingsError(
                        f"machine.{name} and machine.{ends[blocks[-1]]} end with the same block {blocks[-1]!r}"
                    )
                ends[blocks[-1]] = name
            for i, block in enumerate(blocks):
                self._add(block, (name,) if name in SWITCHES and i == len(blocks) - 1 else ())

    def _add(self, block: str, switches: tuple[str, ...]) -> None:
        if "{" not in block:
            known = self._literal.get(block)
            self._literal[block] = StateChange(switches or (known.switches if known else ()), ())
            return
        pattern = re.compile("".join(_pattern_parts(block)), re.IGNORECASE)
        self._patterns.append((pattern, switches))
        self._patterns.sort(key=lambda entry: not entry[1])

    def find(self, code: str) -> StateChange | None:
        """Return what the block does, if it is of a template; words set apart by any number of blanks."""
        if code not in self._memory:
            self._memory[code] = self._search(" ".join(code.split()))
        return self._memory[code]

    def _search(self, code: str) -> StateChange | None:
        if code in self._literal:
            return self._literal[code]
        for pattern, switches in self._patterns:
            found = pattern.fullmatch(code)
            if found:
                values = tuple(
                    (group.rsplit("__", 1)[0], float(text)) for group, text in found.groupdict().items()
                )
                return StateChange(switches, values)
        return None


def _code(line: str) -> str:
    """Return the block of a template line, without its comment, in upper case but for the placeholders."""
    code = " ".join(line.split(";", 1)[0].split())
    return re.sub(r"(\{[^}]*\})|([^{]+)", lambda m: m[1] or m[2].upper(), code)


def _pattern_parts(block: str) -> Iterator[str]:
    for count, (literal, name, _spec, _conversion) in enumerate(Formatter().parse(block)):
        yield re.escape(literal)
        if name is not None:
            yield f"(?P<{name}__{count}>{NUMBER})"
