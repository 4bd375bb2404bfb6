"""Plugins of other distributions: answers of a process of their own, kept until their code changes; their slicers."""

from __future__ import annotations

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
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Annotated, Any, ClassVar, NoReturn, Self

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError

from ebamcheck.atomic_file import replacing
from ebamcheck.backend import BackendSettings, CoplanarRule, Probe
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.installed import distribution_of
from ebamcheck.plugins.processes import one_line, run_limited
from ebamcheck.plugins.trial import ANSWERS, QUESTION, Line, ProbeTold, Question, Told
from ebamcheck.version import __version__


def code_stamp(point: EntryPoint) -> str:
    """Hash of names, sizes and times of the files of a plugin's package; nothing is imported. Empty where they cannot be told."""
    top = str(point.value).split(":")[0].split(".")[0].strip()
    try:
        spec = importlib.util.find_spec(top)
    except Exception:  # finders of others may raise anything
        return ""
    if spec is None:
        return "none"
    files = {Path(spec.origin)} if spec.origin and Path(spec.origin).is_file() else set()
    for folder in spec.submodule_search_locations or ():
        for file in Path(folder).rglob("*"):
            if file.suffix in (".py", ".so", ".pyd", ".pth"):
                files.add(file)
            if len(files) > 5000:  # what is known of so large a plugin is not kept
                return ""
    lines = []
    for file in sorted(files):
        with suppress(OSError):
            status = file.stat()
            lines.append(f"{file} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest() if lines else ""


TIME_VARIABLE = "EBAMCHECK_PLUGIN_TIME_S"  # takes the place of :data:`TRIAL_TIME_S`
TRIAL_TIME_S = (
    60.0  # time to import a plugin and to ask it what it is: a large one that has never been imported takes 20 s
)
TRIAL_MEMORY_MB = 4096.0  # resident memory of a plugin that does no work yet
FAILURE_KEPT_S = 600.0  # a failure is believed for so long where the plugin's code stays the same: what it lacked may be installed since
CACHE_FORMAT = 2

_KEEPING = threading.Lock()


class Attributes(Told):
    """Attributes of a slicer that are plain values."""

    name: Line
    summary: Line
    exact: bool
    priority: Annotated[int, Field(ge=-1_000_000, le=1_000_000)]
    coplanar_rule: CoplanarRule
    inside_rule: Line


# What each value has to be, in a user's words
KINDS: Mapping[str, str] = {
    **dict.fromkeys(("name", "summary", "inside_rule", "why", "hint", "device"), "a line of text"),
    **dict.fromkeys(("exact", "available"), "True or False"),
    "priority": "a whole number from -1000000 to 1000000",
    "coplanar_rule": "'half-open' or 'undefined'",
    "versions": "texts by name",
}


class Answer(BaseModel):
    """What is known of a stranger's slicer, or why it is left out."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    failure: str = ""
    attributes: Attributes | None = None
    lineage: tuple[str, ...] = ()
    defaults: dict[str, Any] | None = None
    probed: Probe = Probe(False)
    # Of a cube of 100 mm under default settings; None where it told no finite ones
    bounds_mm: tuple[float, float] | None = None


def ask(point: EntryPoint, kind: str, values: Mapping[str, Any] | None = None) -> tuple[dict[str, Any], str]:
    """Ask a plugin in a process of its own; returns all that it told, by name, and what went wrong: empty if nothing."""
    group, name, value = map(str, (point.group, point.name, point.value))
    question = Question(kind=kind, group=group, name=name, value=value, settings=dict(values or {}))
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
    with suppress(ValueError):
        if not text or float(text) > 0.0:
            return float(text or TRIAL_TIME_S)
    raise SettingsError(f"{TIME_VARIABLE}={text!r}: give a positive number of seconds, or unset it")


def _told(file: Path) -> dict[str, Any]:
    told: dict[str, Any] = {}
    with suppress(OSError), file.open("rb") as answers:
        for line in answers.read(1_000_000).splitlines():
            with suppress(ValueError, RecursionError):
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
    return Answer(
        attributes=attributes,
        defaults=defaults if isinstance(defaults, dict) else None,
        lineage=tuple(map(str, lineage)) if isinstance(lineage, list) else (),
        bounds_mm=_bounds(told.get("bounds")),
        probed=_probe(told, wrong),
    )


def _probe(told: Mapping[str, Any], wrong: str) -> Probe:
    if "probe" not in told:
        why = wrong or "it told nothing"
        raised = "ended the process" not in why and ": " in why
        return Probe(False, f"its probe {'raised ' if raised else 'failed: '}{why}")
    try:
        return Probe(**ProbeTold.model_validate(told["probe"]).model_dump())
    except ValidationError as error:
        return Probe(False, f"its probe's {_first(error)}")


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
    key, code = f"{point.group} {point.name} {point.value}", code_stamp(point)
    # What has to be the same for a kept answer to hold.
    distribution = " ".join(distribution_of(point))
    stamp = f"{distribution} | {code} | {platform.python_version()} | {__version__}"
    kept = {} if fresh or not code else _kept()
    if (found := _sound(kept.get(key), stamp)) is not None:
        return found
    answer = ask_slicer(point)
    if code:
        _keep(key, stamp, answer)
    return answer


def cache_file() -> Path:
    """Where answers are kept: ``$XDG_CACHE_HOME/ebamcheck/plugins.json``, or in ``~/.cache``."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(home) if home else Path.home() / ".cache") / "ebamcheck" / "plugins.json"


def _kept() -> dict[str, Any]:
    """Everything that is kept; nothing where the file is missing, damaged or of another format."""
    with suppress(OSError, ValueError, RecursionError, RuntimeError):
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
    good = answer.attributes is not None and answer.probed.available
    return answer if good or 0.0 <= time.time() - asked_s <= FAILURE_KEPT_S else None


def _keep(key: str, stamp: str, answer: Answer) -> None:
    """Keep an answer; where there is no room for it, the next process asks again."""
    record = {"stamp": stamp, "asked_s": time.time(), "answer": answer.model_dump_json()}
    with suppress(OSError, SettingsError, RuntimeError):
        cache_file().parent.mkdir(parents=True, exist_ok=True)
        with _KEEPING, replacing(cache_file()) as temporary:
            plugins = {**_kept(), key: record}
            temporary.write_text(json.dumps({"format": CACHE_FORMAT, "plugins": plugins}), encoding="utf-8")


class StrangerSettings(BackendSettings):
    """Settings that the slicer itself has checked in a process of its own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    _defaults: dict[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def of(cls, values: Mapping[str, Any], defaults: Mapping[str, Any] | None) -> Self:
        """Settings that a slicer has checked, with its own defaults."""
        made = cls(**{str(k): v for k, v in values.items()})
        made._defaults = dict(defaults or {})
        return made

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Settings as plain values; ``exclude_defaults`` leaves out what is the slicer's own default."""
        found = super().model_dump(**options)
        if not options.get("exclude_defaults"):
            return found
        return {k: v for k, v in found.items() if k not in self._defaults or self._defaults[k] != v}


class StrangerSlicer(Attributes):
    """A slicer of another distribution as it describes itself, in the form of a slicer; its code runs elsewhere."""

    answer: Answer
    point: Any  # its EntryPoint
    Settings: ClassVar[type[BackendSettings]] = StrangerSettings

    @property
    def distribution(self) -> str:
        """Name and version of the distribution that it comes with."""
        return " ".join(distribution_of(self.point)).strip()

    def probe(self) -> Probe:
        """What its probe has answered."""
        return self.answer.probed

    def checked(self, values: Mapping[str, Any]) -> BackendSettings:
        """Have it check settings; raises :class:`SettingsError` naming the first that is wrong."""
        if not values and self.answer.defaults is not None:
            return StrangerSettings.of(self.answer.defaults, self.answer.defaults)
        told, wrong = ask(self.point, "settings", values)
        if isinstance(told.get("wrong"), str):
            raise SettingsError(told["wrong"])
        if wrong or not isinstance(told.get("settings"), dict):
            raise SettingsError(f"backend {self.name!r} did not check its settings: {wrong or 'no answer'}")
        return StrangerSettings.of(told["settings"], self.answer.defaults)

    def _refuse(self, *_: object) -> NoReturn:
        """Refuse what would run its code: see the class."""
        raise BackendFailed(
            f"backend {self.name!r} of {self.distribution or 'another distribution'} runs in a process of its own only: "
            "slice with ebamcheck.slice or `ebamcheck slice`"
        )

    error_bound_mm = height_bound_mm = prepare = _refuse


def stranger(point: EntryPoint, answer: Answer) -> StrangerSlicer:
    """The slicer of an answer that has attributes."""
    assert answer.attributes is not None
    return StrangerSlicer(**answer.attributes.model_dump(), answer=answer, point=point)
