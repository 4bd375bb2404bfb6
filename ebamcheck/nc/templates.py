"""Filling the beam and wire templates of the machine profile."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

from ebamcheck.errors import SettingsError
from ebamcheck.nc.increments import increments_of, to_increment
from ebamcheck.nc.numbers import plain
from ebamcheck.nc.profile import templates_of
from ebamcheck.nc.special_rules import checked_preheating, checked_tilt
from ebamcheck.nc.template_rules import checked_templates
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import wire_speed_mm_s

LONGEST_BLOCK = 200
"""Characters of a block that every software version of the control takes."""


class _Value(float):
    """A number that a bare placeholder prints without exponent and trailing zeros."""

    def __format__(self, spec: str) -> str:
        if spec:
            return float(self).__format__(spec)
        return plain(self)


@dataclass(frozen=True)
class ProcessValues:
    """What the placeholders of the templates stand for in one layer; its wire speed is that of a bead by itself."""

    power_w: float
    voltage_kv: float
    current_ma: float
    wire_mm_s: float
    wire_retract_mm: float
    feed_mm_min: float
    layer_pause_s: float
    layer: int
    height_mm: float
    defocus: float = 0.0
    increments: Mapping[str, float] = field(default_factory=dict)
    """Least step of each value that has one: it is printed as a multiple of it."""

    def printed(self, name: str) -> float:
        """One of the values as it is printed."""
        return to_increment(getattr(self, name), self.increments.get(name, 0.0))

    @cached_property
    def _placeholders(self) -> _Placeholders:
        """What is put for each placeholder, of all templates of a moment."""
        return _Placeholders(self)

    def at(self, power: float, wire: float) -> ProcessValues:
        """The same values at a share of the beam's power, by its current, and a share of the wire speed."""
        return replace(
            self,
            power_w=power * self.power_w,
            current_ma=power * self.current_ma,
            wire_mm_s=wire * self.wire_mm_s,
        )

    def fill(self, name: str, template: Iterable[str]) -> list[str]:
        """Fill the lines of the template `name`; raises :class:`SettingsError` for what makes no block."""
        return [_filled(f"machine.{name}", line, self._placeholders) for line in template]


class _Placeholders(dict[str, object]):
    """What stands for the placeholders of templates, each worked out when it is first asked for."""

    def __init__(self, values: ProcessValues) -> None:
        super().__init__()
        self._values = values

    def __missing__(self, name: str) -> object:
        if name not in PLACEHOLDERS:
            raise KeyError(name)
        value = self._values.printed(name)
        self[name] = found = value if isinstance(value, int) else _Value(value)
        return found


PLACEHOLDERS = tuple(one.name for one in fields(ProcessValues) if one.name != "increments")
"""Names that stand for values in a template."""


def _filled(where: str, line: str, values: Mapping[str, object]) -> str:
    try:
        text = line.format_map(values)
    except KeyError as error:
        raise SettingsError(
            f"{where}: {line!r}: unknown placeholder {error}; known are {', '.join(PLACEHOLDERS)}"
        ) from None
    except (ValueError, IndexError, AttributeError) as error:
        raise SettingsError(f"{where}: {line!r} is not a template: {error}") from None
    if not text.isascii() or not text.isprintable() or len(text) >= LONGEST_BLOCK - 10:
        raise SettingsError(
            f"{where}: {line!r} is not one line of under {LONGEST_BLOCK - 10} ASCII characters"
        )
    return text


def usable_templates(config: Config, control: str) -> dict[str, tuple[str, ...]]:
    """Templates of a control as they are written, each held to its name.

    Raises
    ------
    SettingsError
        For a template that makes no block, or holds what it must not; see :mod:`ebamcheck.nc.template_rules`.
    """
    checked_preheating(config, control)
    checked_tilt(config, control)
    templates = templates_of(config.machine, control)
    sample = process_values(config, 1, config.layer_height_mm, config.layer_height_mm)
    for name, lines in templates.items():
        sample.fill(name, lines)
    checked_templates(config.machine, control)
    if config.machine.trailing_comments:
        return templates
    bare = {name: [line.split(";", 1)[0].rstrip() for line in lines] for name, lines in templates.items()}
    return {name: tuple(line for line in lines if line) for name, lines in bare.items()}


def process_values(config: Config, layer: int, height_mm: float, thickness_mm: float) -> ProcessValues:
    """Values of the placeholders in a layer, counted from 1."""
    return ProcessValues(
        power_w=config.process.power_w,
        voltage_kv=config.process.voltage_kv,
        current_ma=config.process.current_ma,
        wire_mm_s=wire_speed_mm_s(config, config.process.bead_metal_mm, thickness_mm),
        wire_retract_mm=config.process.wire_retract_mm,
        feed_mm_min=60.0 * config.process.travel_speed_mm_s,
        layer_pause_s=config.process.layer_pause_s,
        layer=layer,
        height_mm=height_mm,
        increments=increments_of(config.machine),
    )
