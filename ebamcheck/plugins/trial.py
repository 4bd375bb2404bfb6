"""Trial of a plugin in a process of its own: it is imported and asked what it is, and every answer is checked. ``python -m
ebamcheck.plugins.trial FOLDER PARENT`` reads ``question.json`` and writes a line of JSON for each answer, kept in a crash."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Annotated, Any, TypedDict

from pydantic import BaseModel, ConfigDict, Field

from ebamcheck.backend import BackendSettings, Probe, Slicer
from ebamcheck.errors import SettingsError
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.plugins.processes import die_with, one_line

QUESTION, ANSWERS = "question.json", "answers"

SLICER_ATTRIBUTES = (
    "name", "summary", "exact", "priority", "coplanar_rule", "inside_rule", "Settings",
    "probe", "error_bound_mm", "height_bound_mm", "prepare",
)  # fmt: skip

TOLD_ATTRIBUTES = SLICER_ATTRIBUTES[:6]  # attributes that are plain values


class Told(BaseModel):
    """What a process of others says, checked by type, range and form."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


Line = Annotated[str, Field(max_length=1000)]


class ProbeTold(Told):
    """A probe's answer."""

    available: bool
    why: Line
    hint: Line
    versions: Annotated[dict[Line, Line], Field(max_length=99)]
    device: Line


class Question(TypedDict):
    """What is asked of a plugin."""

    kind: str  # ``load``: does it import; ``slicer``: what is it; ``settings``: are these values sound
    group: str
    name: str
    value: str
    settings: dict[str, Any]


def cube() -> Part:
    """Cube of 100 mm, for which bounds are told in lists."""
    corners = [(x, y, z) for x in (0, 100) for y in (0, 100) for z in (0, 100)]
    return from_arrays(corners, [(0, 1, 3), (0, 6, 4), (7, 5, 2)])


def checked_slicer(point: EntryPoint) -> Slicer:
    """Load a slicer in this process; raises :class:`TypeError` where it is none."""
    slicer: Slicer = point.load()()
    if missing := [a for a in SLICER_ATTRIBUTES if not hasattr(slicer, a)]:
        raise TypeError(f"it lacks {', '.join(missing)} of the Slicer protocol")
    if slicer.name != point.name:
        raise TypeError(f"it calls itself {slicer.name!r}, its entry point {point.name!r}")
    return slicer


def probed(slicer: Slicer) -> Probe:
    """Ask a slicer in this process whether this machine can run it; whatever it answers or raises, this is a probe."""
    try:
        found: Any = slicer.probe()
    except Exception as error:
        return Probe(False, why=f"its probe raised {type(error).__name__}: {one_line(str(error))}")
    if not isinstance(found, Probe):
        return Probe(False, why=f"its probe returned {type(found).__name__}, not a Probe")
    return found


def checked_settings(name: str, kind: Any, values: Mapping[str, Any]) -> BackendSettings:
    """Check settings of a slicer; raises :class:`SettingsError` naming the first that is wrong."""
    from ebamcheck.settings.checking import checked

    found: BackendSettings = checked(kind, values, f"backend {name!r}")
    return found


def lineage(slicer: object) -> list[str]:
    """Names of a slicer's class and of the classes that it is made from, without those of this harness and Python."""
    named = [f"{kind.__module__}:{kind.__qualname__}" for kind in type(slicer).__mro__]
    ours = ("builtins:", "typing:", "abc:", "ebamcheck.backend:")
    return [name for name in named if not name.startswith(ours)]


# -- the process ---------------------------------------------------------------------------------------


def _answer(question: Question, tell: Callable[..., None]) -> None:
    point = EntryPoint(question["name"], question["value"], question["group"])
    if question["kind"] == "load":
        tell(kind=type(point.load()).__name__)
        return
    slicer = checked_slicer(point)
    kind: Any = slicer.Settings
    if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        shown = kind.__name__ if isinstance(kind, type) else repr(kind)
        raise TypeError(f"its Settings is {one_line(shown, 60)}, not a BackendSettings")
    if question["kind"] == "settings":
        try:
            checked = checked_settings(question["name"], kind, question["settings"])
        except SettingsError as error:
            tell(wrong=str(error))
        else:
            tell(settings=checked.model_dump(mode="json"))
        return
    tell(attributes={a: getattr(slicer, a) for a in TOLD_ATTRIBUTES}, lineage=lineage(slicer))
    # Where there are no default settings they are asked for with the user's own.
    tell(defaults=_or_none(lambda: kind().model_dump(mode="json")))
    found = probed(slicer)
    tell(probe={**asdict(found), "versions": dict(found.versions)})
    # A slicer that cannot tell its bounds may still slice.
    tell(bounds=_or_none(lambda: _bounds(slicer)))


def _bounds(slicer: Slicer) -> list[float]:
    settings, part = slicer.Settings(), cube()
    return [slicer.error_bound_mm(part, settings), slicer.height_bound_mm(part, settings)]


def _or_none(asked: Callable[[], Any]) -> Any:
    try:
        return asked()
    except Exception:
        return None


def main(arguments: Sequence[str]) -> int:
    """Entry point: the folder of question and answers, and the parent's id."""
    folder, parent = arguments
    die_with(int(parent))
    question: Question = json.loads((Path(folder) / QUESTION).read_text(encoding="utf-8"))
    with (Path(folder) / ANSWERS).open("w", encoding="utf-8") as file:

        def tell(**answer: Any) -> None:
            file.write(json.dumps(answer, default=repr) + "\n")
            file.flush()

        try:
            _answer(question, tell)
        except BaseException as error:
            tell(failure=f"{type(error).__name__}: {one_line(str(error))}")
            return 0
        tell(done=True)
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    # What a stranger has left for the interpreter's farewell is not waited for.
    os._exit(code)
