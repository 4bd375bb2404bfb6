"""Settings of a run, read from ``ebamcheck.toml`` or from ``[tool.ebamcheck]`` of a ``pyproject.toml``; unknown keys are
refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

from pydantic import SerializationInfo, SerializerFunctionWrapHandler, model_serializer, model_validator

from ebamcheck.settings.base import Section
from ebamcheck.settings.checking import checked, read_toml
from ebamcheck.settings.machine import KinematicsSettings, MachineSettings, OpcuaSettings
from ebamcheck.settings.materials import MaterialSettings
from ebamcheck.settings.process import ProcessSettings
from ebamcheck.settings.stages import (
    ComparisonSettings,
    CurveSettings,
    HeightMapSettings,
    LayerSettings,
    MachineSections,
    PartSettings,
    PreheatSettings,
    RegressionSettings,
    ScanSettings,
    SlicingSettings,
    WorkSettings,
)
from ebamcheck.showing import short_text


class Config(Section):
    """All settings of a run.

    Parameters
    ----------
    **sections
        Sections by name, each a mapping of its keys; lengths are in mm, times in s, and other units stand in the names.
        What is left out is as by default. :meth:`changed` makes others of them, :func:`load_config` reads a file.

    Raises
    ------
    pydantic.ValidationError
        If a key is unknown or a value out of range; :meth:`changed` and :func:`load_config` raise :class:`SettingsError`.

    Examples
    --------
    >>> config = Config(layers={"layer_height_mm": 2.0})
    >>> config, config.layer_height_mm
    (<Config: layers.layer_height_mm = 2.0>, 2.0)
    >>> config.changed(scan={"order": "raster"}).scan.order
    'raster'
    """

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
        """Leave out preheating and a tilt table where there are none: programs without them keep the hash of their settings."""
        values: dict[str, Any] = handler(self)
        if info.mode == "json":  # hashes are of the values themselves
            return values
        if self.preheat == PreheatSettings():
            values.pop("preheat", None)
        elif self.preheat.scan_in == "own":
            values.get("preheat", {}).pop("scan_in", None)
        for name in ("set_focus", "rotary"):
            if not getattr(self.machine, name):
                values.get("machine", {}).pop(name, None)
        if self.part.on_table is None:
            values.get("part", {}).pop("on_table", None)
        if not self.process.feed_along_path:
            values.get("process", {}).pop("feed_along_path", None)
        if self.process.contour_direction == "same":
            values.get("process", {}).pop("contour_direction", None)
        return values

    def __repr__(self) -> str:
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
    def _sections_agree(self) -> Self:
        splines = self.machine.curve_form == "bspline" and not self.machine.poly_licensed
        if splines and self.process.shapes_bead_ends:
            raise ValueError(
                "process.overlap_mm, seam_shift_mm, ramp_up_mm and crater_fill_mm cut splines, whose parts are written as "
                "POLY: with machine.curve_form 'bspline' machine.poly_licensed is needed; use 'arcs' or 'lines'"
            )
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

    Parameters
    ----------
    path
        The file; of a ``pyproject.toml`` its table ``tool.ebamcheck`` counts. None: no file.

    Returns
    -------
    Config
        All settings, checked.

    Raises
    ------
    SettingsError
        If the file is missing, is not TOML, or a key is unknown or a value out of range; the message
        names the key and the value.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "ebamcheck.toml"
    ...     _ = file.write_text("[layers]\\nlayer_height_mm = 2.0")
    ...     load_config(file)
    <Config: layers.layer_height_mm = 2.0>
    """
    if path is None:
        return Config()
    path = Path(path)
    values = read_toml(path)
    if path.name == "pyproject.toml":
        values = values.get("tool", {}).get("ebamcheck", {})
    return validated(values, str(path))


def validated(values: dict[str, Any], where: str) -> Config:
    """Check a mapping of sections against :class:`Config`."""
    return checked(Config, values, where, "`ebamcheck config` lists every key")
