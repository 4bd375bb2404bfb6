"""Form of ``certificate.json``: which keys it has, and what may stand under each."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, JsonValue

from ebamcheck.record.form import (
    CheckForm,
    FileName,
    FindingForm,
    Form,
    GateForm,
    HeightsForm,
    PartOfRun,
    RunFile,
    Sha256,
    SlicerName,
)

CERTIFICATE_FORMAT = 2


class ReleaseForm(Form):
    """What a person adds."""

    part_number: str
    revision: str
    machine_serial: str
    lots: dict[str, str]
    operator: str
    approver: str
    date: str
    deviations: list[str]


class CertifiedProgram(Form):
    """One file of the program in a certificate."""

    name: FileName
    sha256: Sha256


class SmoothingForm(Form):
    """How far the control may leave the path."""

    words: list[str]
    tolerance_mm: float


class SourceForm(Form):
    """State of the source."""

    commit: str
    dirty: str
    sha256: Sha256


class DeviceForm(Form):
    """What a slicer ran on."""

    device: str
    versions: dict[str, str]


class SoftwareForm(Form):
    """What took part in a run."""

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
