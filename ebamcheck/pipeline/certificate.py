"""The certificate of a run: what was made from what, by what, how well, and room for who approves it.

It stands beside the record of the run. A seal over all that a person does not fill in tells whether it is whole;
the hashes in it tell whether part, settings and programs still are what was certified.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import ebamcheck
from ebamcheck.config import Config, validated
from ebamcheck.errors import InputError
from ebamcheck.pipeline.statement import statement
from ebamcheck.program import Check
from ebamcheck.store import RunFolder, plain, sha256_of_file, sha256_of_json, write_json

CERTIFICATE = "certificate.json"
CERTIFICATE_FORMAT = 1

PROFILE = ("machine", "process", "material", "kinematics")
"""Sections of the settings that describe machine and process."""

BY_HAND = ("approver", "deviations")
"""Fields that a person fills in; the seal leaves them out."""

DEPENDENCIES = ("numpy", "numba", "scipy", "shapely", "pandas", "pyarrow", "pydantic")
"""Distributions whose versions a result can depend on."""


def certificate(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Certificate of a run from its record, sealed, without approver and deviations."""
    config = validated(manifest["settings"], "run.json: settings")
    program = manifest.get("program") or {"files": [], "validated": False}
    fields = {
        "format": CERTIFICATE_FORMAT,
        "part": {key: manifest["part"][key] for key in ("name", "source", "sha256", "mesh_sha256")},
        "settings_sha256": manifest["settings_sha256"],
        "profile_sha256": profile_sha256(manifest["settings"]),
        "record_sha256": record_sha256(manifest),
        "programs": [{"name": f["name"], "sha256": f["sha256"]} for f in program["files"]],
        "primary": manifest["primary"],
        "witness": program.get("witness", ""),
        "software": {
            "ebamcheck": manifest["ebamcheck"],
            "commit": commit(),
            "python": platform.python_version(),
            "dependencies": {name: _version(name) for name in DEPENDENCIES},
        },
        "control": config.machine.control,
        "curve_form": config.machine.curve_form,
        "spline_convention": _convention(config),
        "smoothing": {
            "words": list(config.machine.smoothing),
            "tolerance_mm": config.machine.smoothing_tolerance_mm,
        },
        "gates": manifest["gates"],
        "validated": bool(program["validated"]),
    }
    if "findings" in manifest:  # a run of an earlier version has none
        said = statement(manifest)
        fields |= {"findings": manifest["findings"], "proved": said.proved, "left_to_do": said.left}
    fields = plain(fields)
    return {
        **fields,
        "seal": seal(fields),
        "approver": {"name": "", "date": "", "signature": ""},
        "deviations": [],
    }


def write_certificate(run: RunFolder) -> Path:
    """Write the certificate of a run beside its record, which must be there."""
    path = run.path / CERTIFICATE
    write_json(certificate(run.manifest()), path)
    return path


def seal(fields: Mapping[str, Any]) -> str:
    """SHA-256 of all fields but those filled in by hand and the seal itself."""
    return sha256_of_json({k: v for k, v in fields.items() if k not in (*BY_HAND, "seal")})


def profile_sha256(settings: Mapping[str, Any]) -> str:
    """SHA-256 of the machine profile: the sections of machine, process, material and kinematics, as they were recorded."""
    return sha256_of_json({name: settings[name] for name in PROFILE})


def record_sha256(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of a run's record without its timings."""
    return sha256_of_json({k: v for k, v in manifest.items() if k != "timings"})


def commit() -> str:
    """Commit of the checkout that this package is run from; empty for an installed one."""
    git = Path(ebamcheck.__file__).resolve().parent.parent / ".git"
    try:
        head = (git / "HEAD").read_text(encoding="ascii").strip()
        if not head.startswith("ref: "):
            return head
        name = head.removeprefix("ref: ")
        if (git / name).is_file():
            return (git / name).read_text(encoding="ascii").strip()
        packed = (git / "packed-refs").read_text(encoding="ascii").splitlines()
        return next((line.split()[0] for line in packed if line.endswith(f" {name}")), "")
    except (OSError, UnicodeDecodeError):
        return ""


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _convention(config: Config) -> str:
    shift = config.machine.bspline_shift
    return (
        "PL: even intervals"
        if shift == "uniform"
        else f"PL of block i carries U[i+{shift}] - U[i+{shift - 1}]"
    )


# -- checks ------------------------------------------------------------------------------------------


def find_certificate(program: Path) -> Path | None:
    """Certificate beside a program's folder, or in it."""
    folder = program if program.is_dir() else program.parent
    found = (place / CERTIFICATE for place in (folder, folder.parent))
    return next((path for path in found if path.is_file()), None)


def read_certificate(path: Path) -> dict[str, Any]:
    """Read a certificate; raises :class:`InputError` where it is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if not isinstance(found, dict) or found.get("format") != CERTIFICATE_FORMAT:
        raise InputError(f"{path}: is not a certificate of format {CERTIFICATE_FORMAT}")
    return found


def run_certificate_checks(run: RunFolder, manifest: Mapping[str, Any]) -> list[Check]:
    """Check the certificate of a run folder against its record: every field, by name."""
    path = run.path / CERTIFICATE
    if not path.is_file():
        missing = _faults("certificate", ["the run names a certificate, and there is none"])
        return [missing] if manifest.get("certificate") else []
    found, wanted = read_certificate(path), certificate(manifest)
    # What made the run is known from the certificate alone.
    names = sorted({*wanted, *found} - {*BY_HAND, "seal", "software"})
    differ = [
        f"{name} is not what the record of the run says"
        for name in names
        if found.get(name) != wanted.get(name)
    ]
    return [_sealed(found), _faults("certificate", differ)]


def certificate_checks(path: Path, program: Path, part: Path, config: Config) -> list[Check]:
    """Check part, settings, profile and every program by the hashes of a certificate.

    Raises
    ------
    InputError
        If the certificate cannot be read or lacks a field.
    """
    found = read_certificate(path)
    folder = program if program.is_dir() else program.parent
    try:
        checks = [
            _sealed(found),
            _same("part unchanged", part.name, sha256_of_file(part), found["part"]["sha256"]),
            _same(
                "settings unchanged",
                "settings",
                sha256_of_json(config.model_dump()),
                found["settings_sha256"],
            ),
            _same(
                "profile unchanged",
                "settings",
                profile_sha256(config.model_dump(mode="json")),
                found["profile_sha256"],
            ),
        ]
        programs = [
            _same(
                "program unchanged",
                f"{file['name']}:1",
                _hash_or_missing(folder / file["name"]),
                file["sha256"],
            )
            for file in found["programs"]
        ]
        checks += told_once(programs)
    except (KeyError, TypeError) as error:
        raise InputError(f"{path}: is not whole: {type(error).__name__} at {error}") from None
    return checks


def told_once(files: Sequence[Check]) -> list[Check]:
    """Checks of many files: those that failed, each by itself, or one that says that all are as they were."""
    failed = [check for check in files if not check.passed]
    if failed or not files:
        return failed
    return [replace(files[0], where="", text=f"{len(files)} files by their SHA-256")]


def _hash_or_missing(path: Path) -> str:
    return sha256_of_file(path) if path.is_file() else "missing"


def _sealed(found: Mapping[str, Any]) -> Check:
    broken = (
        []
        if found.get("seal") == seal(found)
        else ["its seal does not fit: it was changed after it was written"]
    )
    return _faults("certificate seal", broken)


def _faults(name: str, faults: list[str]) -> Check:
    text = faults[0] if faults else "as written"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return Check(name, not faults, float(len(faults)), 0.0, "faults", CERTIFICATE, text + more)


def _same(name: str, where: str, found: str, certified: str) -> Check:
    same = found == certified
    text = f"SHA-256 {certified[:16]}..."
    if not same:
        text = f"SHA-256 is {found[:16]}..., certified is {certified[:16]}..."
    return Check(name, same, float(not same), 0.0, "faults", where, text)
