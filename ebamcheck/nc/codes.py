"""What the codes of beam, wire and auxiliaries mean, and the blocks of templates taken apart into them.

No control maker publishes codes of beam and wire: what a code means stands in the machine profile. A block of a template is a row
of such codes; any other word in it is refused, since it would change the machine's state unseen."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ebamcheck.errors import SettingsError
from ebamcheck.nc.control import control
from ebamcheck.nc.words import NUMBER, group_of
from ebamcheck.settings.machine import MachineSettings

TEMPLATES = (
    "beam_on", "beam_off", "wire_start", "wire_stop", "wire_retract",
    "set_beam", "set_power", "set_wire", "set_focus", "layer_begin", "layer_end", "layer_pause",
)  # fmt: skip
SWITCHES = ("beam_on", "beam_off", "wire_start", "wire_stop")  # Meanings that switch beam or wire
BEAM_VALUES = ("voltage_kv", "current_ma", "power_w")
WIRE_VALUES = ("wire_mm_s", "wire_retract_mm")
FOCUS = "defocus"  # Meaning that sets the focus of the beam
VALUES = (*BEAM_VALUES, *WIRE_VALUES, FOCUS)  # Meanings that set a value, each with its unit in its name
AUXILIARY = "auxiliary"
DWELL = "dwell_s"  # Event of a wait that a template holds beside `layer_pause`
BEAM_TEMPLATES = ("beam_on", "beam_off", "set_beam", "set_power")
WIRE_TEMPLATES = ("wire_start", "wire_stop", "set_wire", "wire_retract")
FOCUS_TEMPLATES = ("set_focus",)
NO_PARAMETERS = "XYZUVWGFMNTDIJK"  # Axes, centres, modes, motions, feed, number, tool: behind no code
FLOWS = ("program flow", "tool", "override", "path override")  # Groups that mean the same on every machine
_TOKEN = re.compile(
    rf"""(?:(?P<name>[A-Z][A-Z0-9_]*)\s*=\s*|(?P<letter>[A-Z])\s*)
    (?:(?P<number>{NUMBER})|\{{(?P<placeholder>[a-z_]+)(?::\.\d+f)?\}})(?![\d.{{])\s*""",
    re.VERBOSE,
)
_MESSAGE = re.compile(r"MSG\s*\([^()]*\)")
_MEANINGS = {"on": ("beam_on", "wire_start"), "off": ("beam_off", "wire_stop")}
_AUX = re.compile(r"[MH]\d+(?:=\d+|(?: [A-Z]\d*)*)")


def templates_of(machine: MachineSettings, name: str) -> dict[str, tuple[str, ...]]:
    """Blocks of every template for a control: those of the profile, or the stock ones where it sets none."""
    stock, result = control(name).templates, {}
    for template in TEMPLATES:
        given = getattr(machine, template)
        untouched = given == MachineSettings.model_fields[template].default
        result[template] = stock.get(template, given) if untouched else given
    return result


@dataclass(frozen=True)
class Token:
    """A word of a block: an address, and a number or a placeholder behind it."""

    address: str
    number: str
    placeholder: str
    assigned: bool  # Whether an equals sign stands between

    def names(self) -> tuple[str, ...]:
        """How a declaration may name this word: by its address alone, or with its number."""
        return (self.address, str(self)) if self.number else (self.address,)

    def __str__(self) -> str:
        return f"{self.address}{'=' if self.assigned else ''}{self.number or '{' + self.placeholder + '}'}"


@dataclass(frozen=True)
class Action:
    """What a code of a block does."""

    meaning: str  # A switch, a value, AUXILIARY or DWELL
    placeholder: str  # What is filled in; empty where there is nothing
    number: float | None  # Number that stands there literally
    word: str


Key = tuple[str, ...]  # Words of a code, the last with or without its value


class Codes:
    """The codes of a machine profile and their meanings, for one control."""

    def __init__(self, machine: MachineSettings, dialect: str) -> None:
        self._dialect = dialect
        self._meaning: dict[Key, str] = {}
        stock = control(dialect).codes
        for kind, given, values in (
            ("beam", machine.beam_codes, BEAM_VALUES),
            ("wire", machine.wire_codes, WIRE_VALUES),
        ):
            if given is None:
                own = {code: what for code, what in stock.items() if what.startswith(kind) or what in values}
            else:
                own = dict(_declared(f"machine.{kind}_codes", line, kind, values) for line in given)
            self._meaning |= {_key(code): what for code, what in own.items()}
        templates = {name: blocks_of(lines) for name, lines in templates_of(machine, dialect).items()}
        if machine.beam_codes is None:
            self._derive(templates, BEAM_TEMPLATES, BEAM_VALUES)
        if machine.wire_codes is None:
            self._derive(templates, WIRE_TEMPLATES, WIRE_VALUES)
        self._derive(templates, FOCUS_TEMPLATES, (FOCUS,))
        for code in machine.aux_codes:
            self._meaning[self._auxiliary(code)] = AUXILIARY
        stocked = {_key(code) for code in stock}
        for key, meaning in self._meaning.items():
            if key not in stocked:
                self._refuse_other_words(key, meaning, {axis.name for axis in machine.rotary})

    def _refuse_other_words(self, key: Key, meaning: str, rotary: set[str]) -> None:
        """Refuse a code that is, or holds, a word by which the control would do something else, which no reader would see."""
        group = group_of(self._dialect, key[0])
        wrong = key[0] if group and (key[0][0] == "G" or group.name in FLOWS) else ""
        # A G code may call a macro, whose arguments are A, B, C; behind any other code they are axes.
        others = NO_PARAMETERS + ("" if key[0][0] == "G" else "ABC")
        for word in key[1:]:
            plain = re.fullmatch(r"[A-Z][-+.\d]*", word)
            wrong = word if word.partition("=")[0] in rotary or (plain and word[0] in others) else wrong
        if wrong:
            kind = "wire_codes" if meaning.startswith("wire") else "beam_codes"
            kind = {AUXILIARY: "aux_codes", FOCUS: "set_focus"}.get(meaning, kind)
            what = "is an axis, a motion, a mode, a feed, a tool, or the flow of the program"
            said = f"{' '.join(key)!r} cannot mean {meaning}: to the control {wrong!r} {what}"
            raise SettingsError(f"machine.{kind}: {said}")

    def _auxiliary(self, code: str) -> Key:
        """Words of an auxiliary code; refused where it is one of the control's own or of beam and wire."""
        key = _key(code)
        group = group_of(self._dialect, key[0]) if key else None
        why = "" if _AUX.fullmatch(" ".join(key)) else "give M or H codes, such as 'M77' or 'H9'"
        why = why or (f"it is a word of the control: {group.name}" if group else "")
        why = why or (f"it means {self._meaning[key]}" if key in self._meaning else "")
        if why:
            raise SettingsError(f"machine.aux_codes: {code!r} is no auxiliary code: {why}")
        return key

    def actions(self, where: str, block: str) -> list[Action]:
        """What the codes of a block do, in their order; `where` names the template in a refusal."""
        if _MESSAGE.fullmatch(block):
            return []
        tokens = tokens_of(where, block)
        result, at = [], 0
        while at < len(tokens):
            found = self._at(tokens, at)
            if found is None:
                token = tokens[at]
                group = group_of(self._dialect, str(token)) or group_of(self._dialect, token.address)
                what = f"is a word of the control ({group.name})" if group else "is declared nowhere"
                what += ": a template holds codes of machine.beam_codes, wire_codes and aux_codes alone"
                raise SettingsError(f"{where}: {block!r}: {str(token)!r} {what}")
            action, used = found
            result.append(action)
            at += used
        return result

    def _at(self, tokens: Sequence[Token], at: int) -> tuple[Action, int] | None:
        """Action of the longest code that begins at a word, and how many words it has."""
        if tokens[at].address == "G" and tokens[at].number == "4" and at + 1 < len(tokens):
            token, address = tokens[at + 1], control(self._dialect).dwell_address
            if token.address != address or token.placeholder not in ("", "layer_pause_s"):
                return None
            seconds = float(token.number) if token.number else None
            return Action(DWELL, token.placeholder, seconds, f"G4 {token}"), 2
        for key in sorted(self._meaning, key=len, reverse=True):
            words = tokens[at : at + len(key)]
            if len(words) == len(key) and all(k in w.names() for k, w in zip(key, words, strict=True)):
                last = words[-1]
                valued = key[-1] == last.address
                text = " ".join(map(str, words))
                number = float(last.number) if valued and last.number else None
                return Action(self._meaning[key], last.placeholder if valued else "", number, text), len(key)
        return None

    def _derive(self, templates: Mapping[str, Sequence[str]], names: Sequence[str], values: Sequence[str]) -> None:
        """Take codes that carry a placeholder to mean it, and the switches where both of a pair are the profile's own."""
        for name in names:
            for block in templates[name]:
                for key, placeholder in self._unknown_values(_tokens(name, block)):
                    if placeholder in values:
                        self._meaning.setdefault(key, placeholder)
        pair = [name for name in names if name in SWITCHES]
        blocks = {name: [_tokens(name, block) for block in templates[name]] for name in pair}
        last = {name: self._unknown_switch(blocks[name]) for name in pair}
        if all(last.values()):
            for name, switch in last.items():
                assert switch is not None
                self._meaning.setdefault(switch, name)

    def _unknown_values(self, tokens: Sequence[Token]) -> Iterator[tuple[Key, str]]:
        at = 0
        while at < len(tokens):
            known = self._at(tokens, at)
            if known is not None:
                at += known[1]
                continue
            unit = [tokens[at], *itertools.takewhile(_parameter, tokens[at + 1 :])]
            end = next((i for i, token in enumerate(unit) if token.placeholder), None)
            if end is not None and _may_be_declared(unit[0]):
                key = (*(token.names()[-1] for token in unit[:end]), unit[end].address)
                yield key, unit[end].placeholder
            at += len(unit)

    def _unknown_switch(self, blocks: Sequence[Sequence[Token]]) -> Key | None:
        """Code in the last block that may be the switch of a profile of its own; None where a stock one is there."""
        known = [self._at(tokens, at) for tokens in blocks for at in range(len(tokens))]
        if not blocks or any(found is not None and found[0].meaning in SWITCHES for found in known):
            return None
        tokens = blocks[-1]
        for at, token in enumerate(tokens):
            if self._at(tokens, at) is None and not token.placeholder and _may_be_declared(token):
                rest = itertools.takewhile(lambda t: _parameter(t) and not t.placeholder, tokens[at + 1 :])
                return (token.names()[-1], *(t.names()[-1] for t in rest))
        return None


def _tokens(name: str, block: str) -> list[Token]:
    """Words of a block of the template `name`; none of a message."""
    return [] if _MESSAGE.fullmatch(block) else tokens_of(f"machine.{name}", block)


def blocks_of(lines: Sequence[str]) -> list[str]:
    """Blocks of a template: its lines without comments, in upper case but for the placeholders, single blanks."""
    codes = (" ".join(line.split(";", 1)[0].split()) for line in lines)
    return [re.sub(r"(\{[^}]*\})|([^{]+)", lambda m: m[1] or m[2].upper(), code) for code in codes if code]


def tokens_of(where: str, block: str) -> list[Token]:
    """Words of a block; raises :class:`SettingsError` where a value is anything but one number or one placeholder."""
    tokens, at = [], 0
    while at < len(block):
        found = _TOKEN.match(block, at)
        if found is None:
            raise SettingsError(
                f"{where}: {block!r}: {block[at:].split()[0]!r} is no code with one number or one placeholder behind it"
            )
        number = f"{float(found['number']):g}" if found["number"] else ""
        name = found["name"]
        tokens.append(Token(name or found["letter"], number, found["placeholder"] or "", bool(name)))
        at = found.end()
    return tokens


def _key(code: str) -> Key:
    return tuple(code.upper().split())


def _declared(where: str, line: str, kind: str, values: Sequence[str]) -> tuple[str, str]:
    code, _, what = (part.strip() for part in line.partition(":"))
    meaning = {f"{word}": pair[kind == "wire"] for word, pair in _MEANINGS.items()}.get(what, what)
    if not code or (meaning not in values and meaning not in SWITCHES):
        raise SettingsError(f"{where}: {line!r}: give CODE: MEANING, with on, off, {', '.join(values)}")
    return code, meaning


def _parameter(token: Token) -> bool:
    return not token.assigned and token.address not in "GMH"


def _may_be_declared(token: Token) -> bool:
    """Whether a word can be a maker's code: no motion, feed, tool, or function of the control."""
    return token.assigned or token.address in "MHSPQE"
