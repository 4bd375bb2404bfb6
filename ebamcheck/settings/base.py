"""The base of all sections of the settings, the ranges of their numbers, and units of length by the names that people give them."""

from __future__ import annotations

import ast
import inspect
import itertools
import math
import sys
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ebamcheck.errors import SettingsError


@dataclass(frozen=True)
class Between:
    """Range of a number, both ends allowed, that every message tells; truth values, texts, NaN and infinities are refused, too."""

    least: float
    greatest: float

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check a number before pydantic does, whose messages name one end alone."""
        whole = source is int
        kind = "whole number" if whole else "number"
        told = f"give a {kind} from {self.least:.10g} to {self.greatest:.10g}"
        number = (
            core_schema.int_schema(ge=math.ceil(self.least), le=math.floor(self.greatest))
            if whole
            else core_schema.float_schema(ge=self.least, le=self.greatest, allow_inf_nan=False)
        )

        def checked(value: Any) -> Any:
            wrong = ""
            if isinstance(value, bool) or not isinstance(value, int | float):
                wrong = "is no number"
            elif not math.isfinite(value):
                wrong = "is not finite"
            elif not self.least <= value <= self.greatest:
                wrong = "is out of range"
            elif whole and value != int(value):
                wrong = "is no whole number"
            if wrong:
                raise PydanticCustomError("range", f"{wrong}: {told}")
            return value

        return core_schema.no_info_before_validator_function(checked, number)


NotNegative = Annotated[float, Between(0.0, 1e9)]  # a number for which no narrower range is known
Tolerance = Annotated[float, Between(0.0, 10.0)]  # distance that something may be off, mm

Place = Annotated[float, Between(-1e7, 1e7)]  # mm: beyond 10 km no machine stands

Length = Annotated[float, Between(0.0, 1e4)]  # length along a bead or between places, mm
Angle = Annotated[float, Between(-360.0, 360.0)]  # turn, degrees
InnerAngle = Annotated[float, Between(0.01, 179.99)]  # angle between two segments or facets, degrees
Share = Annotated[float, Between(0.001, 1.0)]  # part of a whole, which is 1
Temperature = Annotated[float, Between(1.0, 1e4)]  # temperature, K: no metal is liquid at 10,000 K


@cache
def _source(module: str) -> ast.Module:
    return ast.parse(inspect.getsource(sys.modules[module]))


@cache
def explanations(kind: type[BaseModel]) -> dict[str, str]:
    """What each setting of a section is, by name: the text under its annotation; those that say nothing are left out."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, BaseModel) and base is not BaseModel:
            classes = (one for one in ast.walk(_source(base.__module__)) if isinstance(one, ast.ClassDef))
            made = next(one for one in classes if one.name == base.__name__)
            for line, under in itertools.pairwise(made.body):
                if isinstance(line, ast.AnnAssign) and isinstance(under, ast.Expr):
                    found[ast.unparse(line.target)] = inspect.cleandoc(ast.literal_eval(under.value))
    found |= {name: info.description for name, info in kind.model_fields.items() if info.description}
    return {name: text for name, text in found.items() if name in kind.model_fields}


def _described(schema: dict[str, Any], kind: type[BaseModel]) -> None:
    """Tell in a JSON schema what each setting is."""
    for name, text in explanations(kind).items():
        schema["properties"][name]["description"] = text


class Section(BaseModel):
    """Base of every section: unknown keys are refused, values do not change, defaults are checked."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, json_schema_extra=_described)


# Other names of each unit
UNIT_NAMES = {
    "mm": ("millimetre", "millimetres", "millimeter", "millimeters"),
    "cm": ("centimetre", "centimetres", "centimeter", "centimeters"),
    "m": ("metre", "metres", "meter", "meters"),
    "um": ("\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m", "micron", "microns", "micrometre", "micrometer"),
    "in": ("inch", "inches", '"'),
    "ft": ("foot", "feet"),
}

_KNOWN = {name: unit for unit, names in UNIT_NAMES.items() for name in (unit, *names)}


def known_as(name: Any) -> Any:
    """Short name of a unit; what is no name of one comes back as it is.

    >>> known_as("Inches"), known_as(" MM "), known_as("furlong")
    ('in', 'mm', 'furlong')
    """
    return _KNOWN.get(name.strip().lower(), name) if isinstance(name, str) else name


def unit_named(name: str) -> str:
    """Short name of a unit; raises :class:`SettingsError` for one that is not known."""
    unit = known_as(name)
    if unit not in UNITS_MM:
        raise SettingsError(
            f"unknown unit {name!r}: use one of {', '.join(UNITS_MM)}, or a longer name such as inch or inches"
        )
    return str(unit)


# Millimetres in one unit of a model's file
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "in": 25.4, "ft": 304.8}
