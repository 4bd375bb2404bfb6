"""Settings files that are written without losing what stands in one: a new one, or new keys in an old one; and which settings of
two sets differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Item, Table

from ebamcheck.atomic_file import regular_file, replacing
from ebamcheck.errors import SettingsError
from ebamcheck.settings.base import Section
from ebamcheck.settings.checking import as_toml, explained_in_comments, first_line, value_text
from ebamcheck.settings.config import Config, validated
from ebamcheck.showing.short_text import did_you_mean


@dataclass
class Merged:
    """What became of a settings file."""

    text: str = ""
    # Keys that were added, each with its value; and keys that are none, or not any more, each with what may be meant
    added: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)


def write_new(path: Path, config: Config) -> None:
    """Write all settings into a file that is not there yet."""
    if path.exists():
        raise SettingsError(
            f"{path}: is there, and what was set in it would be lost: `ebamcheck config --merge {path}` adds new keys "
            "and keeps the others"
        )
    with replacing(path) as temporary:
        temporary.write_text(as_toml(config), encoding="utf-8")


def merge(path: Path) -> Merged:
    """Add to a settings file the keys that it does not have, with their explanations; where that fails it stays as it was."""
    made = merged(_read(path), path)
    if made.added:
        with replacing(path) as temporary:
            temporary.write_text(made.text, encoding="utf-8", newline="")
    return made


def merged(text: str, path: Path) -> Merged:
    """Text of a settings file, or of the table ``tool.ebamcheck`` of a ``pyproject.toml``, with the keys that it does not have."""
    try:
        document: Any = tomlkit.parse(text)
    except TOMLKitError as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from None
    within = ("tool", "ebamcheck") if path.name == "pyproject.toml" else ()
    root = document
    for key in within:
        root = root.setdefault(key, tomlkit.table())
    found = Merged(unknown=_unknown(root))
    before = validated(_known(root), str(path))
    form = f"{path}: keys cannot be added to a file of this form: write its sections as [NAME]"
    # Of an inline table, and of a section in pieces, tomlkit makes what it can't read back.
    if any(not isinstance(table, Table) for name, table in root.items() if name in Config.model_fields):
        raise SettingsError(form)
    for name, section in Config():
        if type(section).model_fields:
            _complete(root, name, section, found)
    found.text = tomlkit.dumps(document)
    after: Any = tomlkit.parse(found.text)
    for key in within:
        after = after[key]
    if validated(_known(after), str(path)) != before:
        raise SettingsError(form)
    return found


def _complete(root: Any, name: str, section: Section, found: Merged) -> None:
    is_new = name not in root
    table = tomlkit.table() if is_new else root[name]
    there = "" if is_new else table.as_string()
    waiting = ""
    item: Item | None = None
    for key in type(section).model_fields:
        value = getattr(section, key)
        if key in table:
            continue
        explained = "".join(f"{line}\n" for line in explained_in_comments(name, type(section), key))
        if value is None or isinstance(value, dict):
            # What is not set stands as a comment, with the next key that is.
            empty = f"# {key} =" if value is None else f"# [{name}.{key}.NAME]"
            waiting += "" if empty in there else f"{explained}{empty}\n"
            continue
        item = tomlkit.value(value_text(value))
        item.trivia.indent, waiting = waiting + explained, ""
        item.trivia.trail = "\n"
        table.append(key, item)
        found.added.append(f"{name}.{key} = {value_text(value)}")
    if item is not None:
        item.trivia.trail += waiting
    if is_new:
        # Last: keys that are appended to a table take up its indent.
        table.trivia.indent = f"\n# {first_line(type(section))}\n"
        root.append(name, table)


def _unknown(root: Mapping[str, Any]) -> list[str]:
    found = []
    for name, table in root.items():
        if name not in Config.model_fields:
            found.append(f"{name}: unknown key{did_you_mean(name, Config.model_fields)}")
            continue
        kind: Any = Config.model_fields[name].annotation
        if kind.model_config.get("extra") != "allow":
            known = kind.model_fields
            found += [f"{name}.{k}: unknown key{did_you_mean(k, known)}" for k in table if k not in known]
    return found


def _known(root: Any) -> dict[str, Any]:
    """Values of a file without the keys that are none of ours."""
    dropped = {text.partition(":")[0] for text in _unknown(root)}
    kept = {name: table for name, table in root.unwrap().items() if name not in dropped}
    for name, table in kept.items():
        if isinstance(table, dict):
            kept[name] = {key: value for key, value in table.items() if f"{name}.{key}" not in dropped}
    return kept


def _read(path: Path) -> str:
    if not path.exists():
        raise SettingsError(f"{path}: is not there: `ebamcheck config -o {path}` writes a new one")
    try:
        # Line ends as they are.
        return regular_file(path, SettingsError).read_bytes().decode("utf-8")
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SettingsError(f"{path}: is not UTF-8 text, as TOML must be") from None


def differences(one: Config, other: Config) -> list[str]:
    """Settings whose values differ, in their order: ``SECTION.NAME is VALUE, not OTHER VALUE``.

    >>> differences(Config().changed(scan={"seed": 4}), Config())
    ['scan.seed is 4, not 0']
    """
    return list(_differing(one.model_dump(mode="json"), other.model_dump(mode="json"), ""))


def _differing(one: Mapping[str, Any], other: Mapping[str, Any], within: str) -> Iterator[str]:
    for name in dict.fromkeys([*one, *other]):
        mine, its = one.get(name, "nothing"), other.get(name, "nothing")
        if isinstance(mine, Mapping) and isinstance(its, Mapping):
            yield from _differing(mine, its, f"{within}{name}.")
        elif mine != its:
            yield f"{within}{name} is {mine}, not {its}"
