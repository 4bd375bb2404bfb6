"""Form of ``run.json`` and of ``certificate.json``: which keys they have, and what may stand under each; checked once, when they
are read.

What a record *says* is believed by nobody; that is for :func:`ebamcheck.verify`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from ebamcheck.errors import InputError
from ebamcheck.printable import printable
from ebamcheck.result import CODES, Severity

PRINTED = 60  # characters of a name or value that a message quotes


def _only(what: str, is_one: Callable[[str], object]) -> AfterValidator:
    """Let texts pass that are what they are to be; a ValueError says what another one is not."""

    def passed(text: str) -> str:
        if not is_one(text):
            raise ValueError(f"{printable(text, PRINTED)!r} is no {what}")
        return text

    return AfterValidator(passed)


def _is_inside(name: str) -> bool:
    """Whether a name, as ``run.json`` lists it, is that of a file inside of a run folder."""
    steps = name.split("/")
    return not {"", ".", ".."} & {*steps} and "\\" not in name and printable(name) == name


Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_SLICER = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
SlicerName = Annotated[str, _only("name of a slicer", _SLICER.fullmatch)]
_INSIDE = _only("name of a file inside of the run folder", _is_inside)
RunFile = Annotated[str, _INSIDE]
FileName = Annotated[str, _only("plain file name", lambda name: "/" not in name), _INSIDE]
# The name of a part's file is the user's choice
_PART = re.compile(r"(?!\.{0,2}\Z)[^/\0]+")
PartFile = Annotated[str, _only("plain file name", _PART.fullmatch)]
Code = Annotated[str, _only("code of a finding", lambda code: code in CODES)]
SettingsTables = dict[str, dict[str, JsonValue]]
Number = float | Literal["NaN", "Infinity", "-Infinity"]
Figures = dict[str, Number]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]
PLATE = "plate"  # field of the record and of the certificate: one entry a part
FORMAT_VERSION = 2  # of ``run.json``: layers are counted from 1; format 1 counted from 0


class Form(BaseModel):
    """A table of a record: no key more than these, each of its own type."""

    model_config = ConfigDict(extra="forbid", strict=True)


class GateForm(Form):
    name: str
    passed: bool
    figure: Number
    limit: Number
    unit: str
    text: str


class CheckForm(Form):
    name: str
    passed: bool
    value: Number
    limit: Number
    unit: str
    where: str
    text: str
    layer: int | None = None
    x_mm: Number | None = None
    y_mm: Number | None = None
    place: str = ""
    remedy: str = ""


class FindingForm(Form):
    severity: Severity
    code: Code
    text: str
    place: str = ""
    figure: Number | None = None
    limit: Number | None = None
    unit: str = ""
    remedy: str = ""


class CertifiedProgram(Form):
    name: FileName
    sha256: Sha256


class ProgramFile(CertifiedProgram):
    blocks: Count = 0


class EntryForm(Form):
    layer: Count
    validated: bool
    files: Annotated[list[ProgramFile], Field(min_length=1)]
    check: CheckForm


class LiveForm(CertifiedProgram):
    validated: bool
    check: CheckForm


class TotalsForm(Form):
    contour_mm: Finite
    hatch_mm: Finite
    travel_mm: Finite
    deposit_s: Finite
    travel_s: Finite
    pause_s: Finite = 0.0
    wire_mm: Finite
    wire_kg: Finite
    motions: Finite = 0.0


class ScanForm(Form):
    model_config = ConfigDict(extra="allow")  # further sums, of runs with other beads
    __pydantic_extra__: dict[str, Finite]

    order: str
    seed: Count
    islands: Count
    hatch_mm: Finite
    travel_mm: Finite
    starts: Finite
    time_s: Finite


class FeedForm(Form):
    blocks: Number
    time_s: Number
    constant_feed_s: Number
    dips: Number
    dip_s: Number
    least_share: Number
    length_mm: Number
    excess_mm3: Number
    excess_mm3_per_m: Number


class TimingsForm(Form):
    finished: str
    machine: str
    part_path: str = ""
    stages_s: dict[str, Finite]
    compile_s: Finite = 0.0
    backends: dict[SlicerName, dict[str, Finite]]


class ProgramForm(Form):
    checks: list[CheckForm]
    witness: SlicerName
    totals: TotalsForm
    validated: bool
    files: Annotated[list[ProgramFile], Field(min_length=1)]
    entry: EntryForm | None = None
    live: LiveForm | None = None


class DeviceForm(Form):
    device: str
    versions: dict[str, str]


class BackendForm(DeviceForm):
    status: str
    why: str
    summary: str
    exact: bool
    coplanar_rule: str
    inside_rule: str
    error_bound_mm: Number
    height_bound_mm: Number
    settings: dict[str, JsonValue]
    rings: Count
    open_paths: Count
    points: Count
    file: RunFile | Literal[""]


class PairForm(Form):
    a: SlicerName
    b: SlicerName
    layers: Count
    gated: Count
    agree: Count
    limit_mm: Number
    max_depth_mm: Number
    max_hausdorff_mm: Number
    max_p95_mm: Number
    max_area_difference_mm2: Number
    min_iou: Number


class EvidenceForm(Form):
    methods: list[SlicerName]
    first_layer: Count
    last_layer: Count


class DisagreementForm(Form):
    layer: int
    height_mm: Number
    backend: str
    against: str
    metric: str
    value: Number
    limit: Number
    x_mm: Number
    y_mm: Number
    cause: str
    cause_text: str = ""
    cause_size: Number | None = None
    cause_unit: str = ""
    cause_share: Number | None = None
    remedy: str = ""
    program_z_mm: Number


class ComparisonForm(Form):
    compared_layers: Count
    passed: bool
    verdicts: dict[str, Count]
    classes: dict[str, Count]
    pairs: list[PairForm]
    evidence: list[EvidenceForm]
    no_evidence: dict[SlicerName, str]
    findings: list[DisagreementForm]


class PartOfRun(Form):
    name: str
    source: PartFile
    sha256: Sha256
    mesh_sha256: Sha256 | Literal[""]  # empty in a check in slabs, in which the mesh is never whole
    units: str
    units_from: str = ""
    direction: Annotated[list[float], Field(min_length=3, max_length=3)]
    place_at_mm: list[float] | None = None
    rotate_deg: float = 0.0


class InspectedPart(PartOfRun):
    inspection: dict[str, JsonValue]


class HeightsForm(Form):
    count: Count
    first_mm: float
    last_mm: float
    layer_height_mm: float


class MethodForm(Form):
    blocks: Count
    max_bulge_mm: Number
    max_points_mm: Number


class FitForm(MethodForm):
    method: str
    points: Count
    rings: Count
    fallen_rings: dict[str, Count]
    open_rings: Count
    methods: dict[str, MethodForm]


class HeatForm(Form):
    limit_k: Number
    build_s: Figures


class RecordForm(Form):
    """``run.json``."""

    format: Literal[2]
    job: Literal["run", "check"]
    fingerprint: str
    ebamcheck: str
    python: str
    part: InspectedPart
    settings: SettingsTables
    settings_sha256: Sha256
    heights: HeightsForm
    primary: SlicerName | Literal[""]
    backends: dict[SlicerName, BackendForm]
    comparison: ComparisonForm
    plate: list[dict[str, JsonValue]] = []
    slabs: dict[str, JsonValue] = {}
    fit: FitForm | None = None
    reference: dict[str, JsonValue] | None = None
    kinematics: dict[Literal["program", "polyline"], FeedForm] = {}
    heat: HeatForm | None = None
    program: ProgramForm | None = None
    scan: ScanForm | None = None
    gates: list[GateForm]
    findings: list[FindingForm] = []
    exit_code: Annotated[int, Field(ge=0, le=5)]
    files: dict[RunFile, Sha256]
    timings: TimingsForm | None = None  # in the record of runs of earlier versions

    @model_validator(mode="after")
    def _slicers_of_the_run(self) -> Self:
        done = sorted(name for name, found in self.backends.items() if found.status == "done")
        named = {"primary": self.primary, "program.witness": self.program.witness if self.program else ""}
        for key, name in named.items():
            if name and name not in done:
                there = ", ".join(done) or "none"
                raise ValueError(f"{key} {name!r} is no slicer of this run: it has {there}")
        return self


_Form = TypeVar("_Form", bound=Form)


def in_form(kind: type[_Form], found: Any, where: Path) -> dict[str, Any]:
    """Return a table that has the form of its kind, as it was read; the InputError of another names the first key that is wrong."""
    try:
        kind.model_validate(found)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = printable(".".join(str(step) for step in first["loc"]), PRINTED)
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        what = printable(first["msg"].removeprefix("Value error, "), 2 * PRINTED)
        raise InputError(f"{where}: is not whole: {place or 'all of it'}: {what}{more}") from None
    return dict(found)


# -- the certificate -------------------------------------------------------------------------------

CERTIFICATE_FORMAT = 2


class ReleaseForm(Form):
    part_number: str
    revision: str
    machine_serial: str
    lots: dict[str, str]
    operator: str
    approver: str
    date: str
    deviations: list[str]


class SmoothingForm(Form):
    words: list[str]
    tolerance_mm: float


class SourceForm(Form):
    commit: str
    dirty: str
    sha256: Sha256


class SoftwareForm(Form):
    ebamcheck: str
    source: SourceForm
    python: str
    system: str
    dependencies: dict[str, str]
    backends: dict[SlicerName, DeviceForm]


class CertificateForm(Form):
    """``certificate.json``."""

    format: Literal[2]
    finished: str
    part: PartOfRun
    heights: HeightsForm
    settings_sha256: Sha256
    profile_sha256: Sha256
    record_sha256: Sha256
    programs: list[CertifiedProgram]
    primary: SlicerName | Literal[""]
    witness: SlicerName | Literal[""]
    software: SoftwareForm
    control: str
    curve_form: str
    spline_convention: str
    smoothing: SmoothingForm
    gates: list[GateForm]
    checks: list[CheckForm]
    validated: bool
    not_proved: list[str]
    plate: list[dict[str, JsonValue]] = Field(default_factory=list)
    findings: list[FindingForm] = Field(default_factory=list)
    proved: list[str] = Field(default_factory=list)
    left_to_do: list[str] = Field(default_factory=list)
    release: ReleaseForm
    files: dict[RunFile, Sha256]
    seal: str
