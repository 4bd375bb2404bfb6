"""A control: how its programs are written, what their words mean, and how they are read back.

A control is one plugin, an entry point of the group ``ebamcheck.controls`` that holds a :class:`Control`; the setting
``machine.control`` names it. Writer and reader are named, not imported: neither can lean on the other."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

from ebamcheck.errors import SettingsError
from ebamcheck.plugins import registry
from ebamcheck.settings.machine import MachineSettings

Splines = Literal["cubics", "arcs", "chords"]
"""What becomes of a spline in a program: cubic spans, arcs, or chords."""


@dataclass(frozen=True)
class Group:
    """A modal group: its name in the field's words, and the words that belong to it."""

    name: str
    words: tuple[str, ...]
    path: bool = False
    """Whether it says how the axes follow the path, and not what the path is: the check `smoothing` is about it."""


def offsets(first: int, last: int) -> tuple[str, ...]:
    """Words G`first` to G`last`."""
    return tuple(f"G{number}" for number in range(first, last + 1))


@dataclass(frozen=True)
class Control:
    """What the house knows of one control.

    >>> control("linuxcnc").suffixes, control("3dthesis").is_read
    (('.NGC',), False)
    """

    name: str  # As ``machine.control`` and the entry point name it
    writer: str  # ``module:function`` that writes a program, as :func:`ebamcheck.write_program` does
    # ``module:function`` that reads one back: main file and settings in, :class:`~ebamcheck.nc.motions.NCProgram` out. Empty: what is
    # written is the input of a simulator, and no reader proves it.
    reader: str = ""
    title: str = ""  # Name in the header of a program; that of the plugin where it is empty
    suffixes: tuple[str, ...] = ()  # Endings of main files in capitals, the one that is written first
    mark: bytes = b""  # First bytes of a file of this control, whatever its ending
    subprogram_suffix: str = ""  # Ending of subprograms; empty for a program of one file
    # Pattern of the names, in capitals, of files that the control takes for its own in a folder. Empty: it is given files one by one.
    loads: str = ""
    # Beam and wire blocks in place of the defaults of the machine section, for a profile that sets none; and meanings of their codes.
    templates: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    codes: Mapping[str, str] = field(default_factory=dict)
    dwell_address: str = "F"  # Address of G4 that carries seconds
    groups: tuple[Group, ...] = ()  # Modal groups; words that the control does not know may be among them
    # Words that hold at every motion of a program, one of each group.
    words: Callable[[MachineSettings], tuple[str, ...]] = field(default=lambda machine: ())
    # ``KEY: VALUE`` lines of the header: how curves are given, and how far the control may leave the path.
    form_lines: Callable[[MachineSettings], dict[str, str]] = field(default=lambda machine: {})
    splines: Splines = "cubics"  # What becomes of them where ``machine.curve_form`` asks for no arcs or lines
    tolerance_word: str = ""  # How the tolerance of the path is given, as in ``CTOL=``; empty: by no word
    smoothing_needs_tolerance: str = ""  # Word by which the path leaves corners by any distance without one
    # Words of smoothing under which the path stays within that tolerance, of which the profile needs one. Empty: there are no others.
    keeps_tolerance: tuple[str, ...] = ()
    parentheses: bool = False  # Whether a comment stands in parentheses, and not behind a semicolon
    # ``module:function`` that writes the main program that waits between layers: (settings, Z of the part's top, header) in, name and text
    # out; and one that judges its text: (text, name of the file, settings, Z) in, :class:`~ebamcheck.result.Check` out. Empty: none.
    waiting: str = ""
    handshake: str = ""
    rapids_apart: bool = False  # Whether a rapid may go anywhere in the box around its ends, axis by axis
    frames: bool = False  # Whether its programs turn a tilt table (``machine.rotary``), and set frames
    file_faults: str = ""  # ``module:function`` that checks names and heads: (program, settings) to faults

    @property
    def is_read(self) -> bool:
        """Whether programs of this control are read back, and can be validated."""
        return bool(self.reader)

    def comment_text(self, text: str) -> str:
        """A comment's text as it can stand in one: without parentheses where these are its ends."""
        return text.translate({40: "[", 41: "]"}) if self.parentheses else text

    def written(self, *given: Any, path: Any, **named: Any) -> Any:
        """Write a program; a writer that takes the tracks that are laid out already is spared laying them out again."""
        writer = self.load("writer")
        if "path" in inspect.signature(writer).parameters:
            named["path"] = path
        return writer(*given, **named)

    def load(self, what: Literal["writer", "reader", "file_faults", "waiting", "handshake"]) -> Any:
        """Import one of the functions that are named here; raises :class:`SettingsError` where that fails."""
        place = getattr(self, what)
        try:
            return pkgutil.resolve_name(place)
        except (ImportError, AttributeError, ValueError) as error:
            said = f"control {self.name!r}: {what} {place!r} cannot be loaded: {error}"
            raise SettingsError(said) from None


@cache
def control(name: str) -> Control:
    """Return the control of that name; SettingsError, with those that there are, for another, or where the plugin is no control."""
    found = registry.plugin(registry.CONTROLS, name)
    if not isinstance(found, Control) or found.name != name:
        what = f"plugin {name!r} of {registry.CONTROLS} is no Control of that name: {found!r:.80}"
        raise SettingsError(what)
    return found


def controls() -> dict[str, Control]:
    """Return all controls by name; a broken plugin warns and is left out."""
    found = registry.load_plugins(registry.CONTROLS)
    return {name: plugin for name, plugin in found.items() if isinstance(plugin, Control)}


def simulators() -> tuple[str, ...]:
    """Names of the controls that are heat simulators: what is written for them is not read back."""
    return tuple(name for name, found in controls().items() if not found.is_read)
