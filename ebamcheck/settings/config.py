"""Settings of a run, read from ``ebamcheck.toml`` or from ``[tool.ebamcheck]`` of a ``pyproject.toml``.

The sections are those of :mod:`ebamcheck.settings`; unknown keys are refused. The machine, process and material sections
together are the *machine profile*.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, get_args, get_origin

from pydantic import (
    BaseModel,
    SerializationInfo,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic.fields import FieldInfo

from ebamcheck.errors import SettingsError
from ebamcheck.settings.base import Section
from ebamcheck.settings.curves import CurveSettings
from ebamcheck.settings.height_map import HeightMapSettings
from ebamcheck.settings.machine import KinematicsSettings, MachineSettings
from ebamcheck.settings.material import MaterialSettings
from ebamcheck.settings.opcua import OpcuaSettings
from ebamcheck.settings.preheat import PreheatSettings
from ebamcheck.settings.process import ProcessSettings
from ebamcheck.settings.scan import ScanSettings
from ebamcheck.settings.selection import MachineChoice, MachineSections, RegressionSettings
from ebamcheck.settings.slicing import (
    ComparisonSettings,
    LayerSettings,
    PartSettings,
    SlicingSettings,
)
from ebamcheck.settings.wording import wanted
from ebamcheck.settings.work import WorkSettings
from ebamcheck.showing import short_text


class Config(Section):
    """All settings of a run."""

    part: PartSettings = PartSettings()
    layers: LayerSettings = LayerSettings()
    slicing: SlicingSettings = SlicingSettings()
    comparison: ComparisonSettings = ComparisonSettings()
    curves: CurveSettings = CurveSettings()
    scan: ScanSettings = ScanSettings()
    machine: MachineSettings = MachineSettings()
    process: ProcessSettings = ProcessSettings()
    kinematics: KinematicsSettings = KinematicsSettings()
    material: MaterialSettings = MaterialSettings()
    regression: RegressionSettings = RegressionSettings()
    machines: MachineSections = MachineSections()
    opcua: OpcuaSettings = OpcuaSettings()
    height_map: HeightMapSettings = HeightMapSettings()
    preheat: PreheatSettings = PreheatSettings()
    work: WorkSettings = WorkSettings()

    @model_serializer(mode="wrap")
    def _as_before(self, handler: SerializerFunctionWrapHandler, info: SerializationInfo) -> dict[str, Any]:
        """Leave out preheating where it is off and as it is by default: programs without it keep the hash of their settings."""
        values: dict[str, Any] = handler(self)
        if info.mode == "json":  # hashes are of the values themselves
            return values
        if self.preheat == PreheatSettings():
            values.pop("preheat", None)
        if not self.machine.set_focus:
            values.get("machine", {}).pop("set_focus", None)
        return values

    def __repr__(self) -> str:
        """Name the settings that are not the default ones."""
        base, values = Config.model_construct().model_dump(), self.model_dump()
        changed = [
            f"{section}.{name} = {value!r}"
            for section, found in values.items()
            for name, value in found.items()
            if base.get(section, {}).get(name) != value
        ]
        return short_text.line("Config", *(changed or ["the default settings"]))

    __str__ = __repr__

    @property
    def layer_height_mm(self) -> float:
        """Layer height: the one set, else that of one bead."""
        return self.layers.layer_height_mm or self.process.bead_height_mm

    @property
    def base_mm(self) -> float:
        """Z of what stands under the lowest layer."""
        return self.layers.base_mm

    @property
    def contour_offset_mm(self) -> float:
        """Inset of the contour bead's centre line, mm, less the allowance for machining."""
        offset = self.scan.contour_offset_mm
        inset = 0.5 * self.process.bead_width_mm if offset is None else offset
        return inset - self.process.machining_allowance_mm

    @model_validator(mode="after")
    def _cut_splines_can_be_written(self) -> Self:
        if (
            self.machine.curve_form == "bspline"
            and not self.machine.poly_licensed
            and self.process.shapes_bead_ends
        ):
            raise ValueError(
                "process.overlap_mm, seam_shift_mm, ramp_up_mm and crater_fill_mm cut splines, whose parts are written as "
                "POLY: with machine.curve_form 'bspline' machine.poly_licensed is needed; use 'arcs' or 'lines'"
            )
        return self

    @model_validator(mode="after")
    def _allowance_within_the_inset(self) -> Self:
        if self.contour_offset_mm < 0.0:
            raise ValueError(
                f"process.machining_allowance_mm {self.process.machining_allowance_mm:g} is over the inset of the contour "
                "beads: a section cannot grow; give a larger scan.contour_offset_mm or grow the part"
            )
        return self

    def changed(self, **sections: dict[str, Any]) -> Config:
        """Return the settings with some values of some sections changed, checked anew."""
        values = self.model_dump()
        for section, changes in sections.items():
            # Another material brings data of its own.
            kept = values.get(section, {}) if section != "material" or "name" not in changes else {}
            values[section] = {**kept, **changes}
        return validated(values, "settings")


def load_config(path: str | Path | None = None) -> Config:
    """Read settings from a TOML file; without one, the defaults.

    Raises
    ------
    SettingsError
        If the file is missing, is not TOML, or a key is unknown or a value out of range; the message
        names the key and the value.
    """
    if path is None:
        return Config()
    path = Path(path)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SettingsError(f"{path}: is not UTF-8 text, as TOML must be") from None
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from None
    if path.name == "pyproject.toml":
        values = values.get("tool", {}).get("ebamcheck", {})
    return validated(values, str(path))


def validated(values: dict[str, Any], where: str) -> Config:
    """Check a mapping of sections against :class:`Config`."""
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise SettingsError(_told(error.errors()[0], where)) from None


def _told(first: Mapping[str, Any], where: str) -> str:
    """Say what is wrong with a value: where, what was given, and what it takes."""
    # Behind the key stand types that were tried, which mean nothing to a user.
    loc = first["loc"]
    place = [*loc[:2], *(k for k in loc[2:] if isinstance(k, int) or _is_key(loc, k))]
    key = ".".join(str(k) for k in place) or "settings"
    given = first.get("input")
    shown = "" if isinstance(given, dict | BaseModel) else f" (given {given!r})"
    if first["type"] == "extra_forbidden":
        key, what = ".".join(map(str, loc)), _unknown_key(loc)
    elif isinstance(given, float) and not math.isfinite(given):
        what = f"it takes {_wanted(loc)}, and a finite one{shown}"
    elif first["type"] == "value_error":
        what = str(first["msg"]).removeprefix("Value error, ") + shown
    else:
        what = f"it takes {_wanted(loc)}" + (
            shown or f" (given a {'table' if isinstance(given, dict) else 'value'})"
        )
    return f"{where}: {key}: {what}; `ebamcheck config` lists every key"


def _is_key(loc: tuple[int | str, ...], name: int | str) -> bool:
    """Whether a part of a place is a key of a table, by itself or in a list."""
    info = _field(loc)
    if info is not None and get_origin(info.annotation) is dict:
        return name == loc[2]
    inner = _inner(loc)
    return inner is not None and name in inner.model_fields


def _inner(loc: tuple[int | str, ...]) -> type[BaseModel] | None:
    """Kind of the tables in a setting that is a list of them."""
    info = _field(loc)
    kinds = get_args(info.annotation) if info is not None else ()
    return next((k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)), None)


def _field(loc: tuple[int | str, ...]) -> FieldInfo | None:
    """The setting at a place; None where a section is meant."""
    section = Config.model_fields.get(str(loc[0])) if len(loc) > 1 else None
    kind = section.annotation if section else None
    return (
        kind.model_fields.get(str(loc[1])) if isinstance(kind, type) and issubclass(kind, BaseModel) else None
    )


def _wanted(loc: tuple[int | str, ...]) -> str:
    """What a setting takes, in a user's words."""
    info, inner = _field(loc), _inner(loc)
    if info is None:
        return (
            "a table of settings"
            if len(loc) <= 1
            else "a table with " + ", ".join(MachineChoice.model_fields)
        )
    key = next((str(k) for k in loc[2:] if _is_key(loc, k)), "")
    if inner is not None and key:
        return wanted(f"{loc[0]}.{loc[1]}", key, inner.model_fields[key])
    return wanted(str(loc[0]), str(loc[1]), info)


def _unknown_key(place: tuple[int | str, ...]) -> str:
    """Say that a key is unknown, and which known one of its section is most like it."""
    section = Config.model_fields.get(str(place[0])) if len(place) > 1 else None
    kind = section.annotation if section else Config
    known = list(kind.model_fields) if isinstance(kind, type) and issubclass(kind, BaseModel) else []
    near = difflib.get_close_matches(str(place[-1]), known, n=1)
    return "unknown key" + (f" (did you mean {near[0]!r}?)" if near else "")
