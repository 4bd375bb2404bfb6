"""Plugins of other distributions: what a separate process found out about each, and their slicers as seen here.

Answers are kept on disk until a plugin's code changes. Of a stranger's slicer this process knows what it has declared, and none of its code.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import math
import os
import platform
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Annotated, Any, ClassVar, NoReturn

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError

from ebamcheck.atomic_file import replacing
from ebamcheck.backend import BackendSettings, CoplanarRule, Probe
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.installed import distribution_of
from ebamcheck.plugins.processes import one_line, run_limited
from ebamcheck.plugins.trial import ANSWERS, QUESTION, Question
from ebamcheck.version import __version__

CODE_SUFFIXES = (".py", ".so", ".pyd", ".pth")  # files whose change makes what is known of a plugin stale
MOST_FILES = 5000  # files of a plugin that are looked at; of a larger one nothing is kept


def code_stamp(point: EntryPoint) -> str:
    """Hash of names, sizes and times of the files of a plugin's package; nothing is imported.

    Empty where they cannot be told: what is known of such a plugin is not kept.
    """
    top = str(point.value).split(":")[0].split(".")[0].strip()
    try:
        spec = importlib.util.find_spec(top)
    except Exception:  # finders of others may raise anything
        return ""
    if spec is None:
        return "none"
    files: list[Path] = []
    if spec.origin and Path(spec.origin).is_file():
        files.append(Path(spec.origin))
    for folder in spec.submodule_search_locations or ():
        for file in Path(folder).rglob("*"):
            if file.suffix in CODE_SUFFIXES:
                files.append(file)
            if len(files) > MOST_FILES:
                return ""
    lines = []
    for file in sorted(set(files)):
        with suppress(OSError):
            status = file.stat()
            lines.append(f"{file} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest() if lines else ""


TIME_VARIABLE = "EBAMCHECK_PLUGIN_TIME_S"  # takes the place of :data:`TRIAL_TIME_S`
TRIAL_TIME_S = 60.0  # time to import a plugin and to ask it what it is: a large one that has never been imported takes 20 s
TRIAL_MEMORY_MB = 4096.0  # resident memory of a plugin that does no work yet
LARGEST_ANSWER_BYTES = 1_000_000  # answers are a few lines; what is longer is none
FAILURE_KEPT_S = 600.0  # a failure is believed for so long where the plugin's code stays the same: what it lacked may be installed since
CACHE_FORMAT = 1

_KEEPING = threading.Lock()

Line = Annotated[str, Field(max_length=1000)]


class _Told(BaseModel):
    """What a stranger says, checked by type, range and form."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


class Attributes(_Told):
    """Attributes of a slicer that are plain values."""

    name: Line
    summary: Line
    exact: bool
    priority: Annotated[int, Field(ge=-1_000_000, le=1_000_000)]
    coplanar_rule: CoplanarRule
    inside_rule: Line


class _ProbeTold(_Told):
    available: bool
    why: Line
    hint: Line
    versions: dict[Line, Line]
    device: Line


# What each value has to be, in a user's words
KINDS: Mapping[str, str] = {
    "name": "a line of text",
    "summary": "a line of text",
    "exact": "True or False",
    "priority": "a whole number from -1000000 to 1000000",
    "coplanar_rule": "'half-open' or 'undefined'",
    "inside_rule": "a line of text",
    "available": "True or False",
    "why": "a line of text",
    "hint": "a line of text",
    "versions": "texts by name",
    "device": "a line of text",
}


class Answer(BaseModel):
    """What is known of a stranger's slicer, or why it is left out."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    failure: str = ""
    attributes: Attributes | None = None
    lineage: tuple[str, ...] = ()
    defaults: dict[str, Any] | None = None
    available: bool = False
    why: str = ""
    hint: str = ""
    versions: dict[str, str] = {}
    device: str = "CPU"
    bounds_mm: tuple[float, float] | None = None
    """Error bound and height bound of a cube of 100 mm under default settings; None where it told no finite ones."""

    def probe(self) -> Probe:
        """The probe's answer."""
        return Probe(self.available, self.why, self.hint, self.versions, self.device)


def ask(point: EntryPoint, kind: str, values: Mapping[str, Any] | None = None) -> tuple[dict[str, Any], str]:
    """Ask a plugin in a process of its own; returns all that it told, by name, and what went wrong: empty if nothing."""
    question: Question = {
        "kind": kind,
        "group": str(point.group),
        "name": str(point.name),
        "value": str(point.value),
        "settings": dict(values or {}),
    }
    with tempfile.TemporaryDirectory(prefix="ebamcheck-", ignore_cleanup_errors=True) as folder:
        (Path(folder) / QUESTION).write_text(json.dumps(question), encoding="utf-8")
        arguments = ["ebamcheck.plugins.trial", folder]
        lost = run_limited(arguments, Path(folder), _time_s(), TRIAL_MEMORY_MB)
        told = _told(Path(folder) / ANSWERS)
    if "failure" in told:
        return told, one_line(str(told["failure"]))
    return told, lost or ("" if told.get("done") is True else "it ended the process with code 0")


def _time_s() -> float:
    text = os.environ.get(TIME_VARIABLE, "")
    with contextlib.suppress(ValueError):
        if not text or float(text) > 0.0:
            return float(text or TRIAL_TIME_S)
    raise SettingsError(f"{TIME_VARIABLE}={text!r}: give a positive number of seconds, or unset it")


def _told(file: Path) -> dict[str, Any]:
    told: dict[str, Any] = {}
    with contextlib.suppress(OSError), file.open("rb") as answers:
        for line in answers.read(LARGEST_ANSWER_BYTES).splitlines():
            with contextlib.suppress(ValueError, RecursionError):
                found = json.loads(line)
                told.update(found if isinstance(found, dict) else {})
    return told


# -- slicers -------------------------------------------------------------------------------------------


def ask_slicer(point: EntryPoint) -> Answer:
    """Ask a slicer what it is, without a look at what is kept; whatever it does, this is an answer."""
    told, wrong = ask(point, "slicer")
    if "attributes" not in told:
        return Answer(failure=wrong or "it told nothing of itself")
    try:
        attributes = Attributes.model_validate(told["attributes"])
    except ValidationError as error:
        return Answer(failure=f"its {_first(error)}")
    if "defaults" not in told:
        return Answer(failure=wrong or "it told nothing of its settings")
    defaults, lineage = told["defaults"], told.get("lineage")
    known: dict[str, Any] = {
        "attributes": attributes,
        "defaults": defaults if isinstance(defaults, dict) else None,
        "lineage": tuple(map(str, lineage)) if isinstance(lineage, list) else (),
        "bounds_mm": _bounds(told.get("bounds")),
    }
    return Answer(**known, **_probe(told, wrong))


def _probe(told: Mapping[str, Any], wrong: str) -> dict[str, Any]:
    if "probe" not in told:
        why = wrong or "it told nothing"
        raised = "ended the process" not in why and ": " in why
        return {"why": f"its probe {'raised ' if raised else 'failed: '}{why}"}
    try:
        return _ProbeTold.model_validate(told["probe"]).model_dump()
    except ValidationError as error:
        return {"why": f"its probe's {_first(error)}"}


def _bounds(told: Any) -> tuple[float, float] | None:
    numbers = told if isinstance(told, list) and len(told) == 2 else []
    good = [float(n) for n in numbers if type(n) in (int, float) and abs(n) < math.inf]
    return (good[0], good[1]) if len(good) == 2 else None


def _first(error: ValidationError) -> str:
    first = error.errors()[0]
    key = str(first["loc"][0]) if first["loc"] else "answer"
    if key not in KINDS:
        return f"answer has {key!r}, which is not asked for"
    return f"{key} is {one_line(repr(first.get('input')), 60)}, not {KINDS[key]}"


# -- what is kept --------------------------------------------------------------------------------------


def slicer_answer(point: EntryPoint, fresh: bool = False) -> Answer:
    """What a stranger's slicer is: as kept on disk, or asked for now, and always if `fresh`."""
    key, stamp = _key(point), _stamp(point)
    kept = {} if fresh or not stamp else _kept()
    if (found := _sound(kept.get(key), stamp)) is not None:
        return found
    answer = ask_slicer(point)
    if stamp:
        _keep(key, stamp, answer)
    return answer


def cache_file() -> Path:
    """Where answers are kept: ``$XDG_CACHE_HOME/ebamcheck/plugins.json``, or in ``~/.cache``."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(home) if home else Path.home() / ".cache") / "ebamcheck" / "plugins.json"


def _key(point: EntryPoint) -> str:
    return f"{point.group} {point.name} {point.value}"


def _stamp(point: EntryPoint) -> str:
    """What has to be the same for a kept answer to hold: distribution, its version and code, Python, and this program."""
    code = code_stamp(point)
    distribution = " ".join(distribution_of(point))
    return f"{distribution} | {code} | {platform.python_version()} | {__version__}" if code else ""


def _kept() -> dict[str, Any]:
    """Everything that is kept; nothing where the file is missing, damaged or of another format."""
    with contextlib.suppress(OSError, ValueError, RecursionError, RuntimeError):
        found = json.loads(cache_file().read_text(encoding="utf-8"))
        if isinstance(found, dict) and found.get("format") == CACHE_FORMAT:
            plugins = found.get("plugins")
            return plugins if isinstance(plugins, dict) else {}
    return {}


def _sound(kept: Any, stamp: str) -> Answer | None:
    """A kept answer, if it is of this stamp, whole, and not too old."""
    if not isinstance(kept, dict) or kept.get("stamp") != stamp:
        return None
    try:
        answer = Answer.model_validate_json(kept["answer"])
        asked_s = float(kept["asked_s"])
    except (KeyError, TypeError, ValueError):
        return None
    good = answer.attributes is not None and answer.available
    return answer if good or 0.0 <= time.time() - asked_s <= FAILURE_KEPT_S else None


def _keep(key: str, stamp: str, answer: Answer) -> None:
    """Keep an answer; where there is no room for it, the next process asks again."""
    record = {"stamp": stamp, "asked_s": time.time(), "answer": answer.model_dump_json()}
    with contextlib.suppress(OSError, SettingsError, RuntimeError):
        cache_file().parent.mkdir(parents=True, exist_ok=True)
        with _KEEPING, replacing(cache_file()) as temporary:
            plugins = {**_kept(), key: record}
            temporary.write_text(json.dumps({"format": CACHE_FORMAT, "plugins": plugins}), encoding="utf-8")


class StrangerSettings(BackendSettings):
    """Settings that the slicer itself has checked in a process of its own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    _defaults: dict[str, Any] = PrivateAttr(default_factory=dict)

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Settings as plain values; ``exclude_defaults`` leaves out what is the slicer's own default."""
        found = super().model_dump(**options)
        if not options.get("exclude_defaults"):
            return found
        return {k: v for k, v in found.items() if k not in self._defaults or self._defaults[k] != v}


def stranger_settings(values: Mapping[str, Any], defaults: Mapping[str, Any] | None) -> StrangerSettings:
    """Settings that a slicer has checked, with its own defaults."""
    made = StrangerSettings(**{str(k): v for k, v in values.items()})
    made._defaults = dict(defaults or {})
    return made


@dataclass(frozen=True)
class StrangerSlicer:
    """What a slicer of another distribution has told of itself.

    It satisfies :class:`~ebamcheck.backend.Slicer` in form. What would run its code is refused:
    :mod:`ebamcheck.slicers.isolation` runs it in a process of its own.
    """

    name: str
    summary: str
    exact: bool
    priority: int
    coplanar_rule: CoplanarRule
    inside_rule: str
    answer: Answer
    point: EntryPoint
    Settings: ClassVar[type[BackendSettings]] = StrangerSettings

    @property
    def distribution(self) -> str:
        """Name and version of the distribution that it comes with."""
        return " ".join(distribution_of(self.point)).strip()

    def probe(self) -> Probe:
        """What its probe has answered."""
        return self.answer.probe()

    def checked(self, values: Mapping[str, Any]) -> BackendSettings:
        """Have it check settings; raises :class:`SettingsError` naming the first that is wrong."""
        if not values and self.answer.defaults is not None:
            return stranger_settings(self.answer.defaults, self.answer.defaults)
        told, wrong = ask(self.point, "settings", values)
        if isinstance(told.get("wrong"), str):
            raise SettingsError(told["wrong"])
        if wrong or not isinstance(told.get("settings"), dict):
            raise SettingsError(f"backend {self.name!r} did not check its settings: {wrong or 'no answer'}")
        return stranger_settings(told["settings"], self.answer.defaults)

    def error_bound_mm(self, *_: object) -> NoReturn:
        """Refuse: see the class."""
        self._refuse()

    def height_bound_mm(self, *_: object) -> NoReturn:
        """Refuse: see the class."""
        self._refuse()

    def prepare(self, *_: object) -> NoReturn:
        """Refuse: see the class."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise BackendFailed(
            f"backend {self.name!r} of {self.distribution or 'another distribution'} runs in a process of its own only: "
            "slice with ebamcheck.slice or `ebamcheck slice`"
        )


def stranger(point: EntryPoint, answer: Answer) -> StrangerSlicer:
    """The slicer of an answer that has attributes."""
    assert answer.attributes is not None
    return StrangerSlicer(**answer.attributes.model_dump(), answer=answer, point=point)
