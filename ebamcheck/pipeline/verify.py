"""Verification after the fact: of a finished run folder, and of a program against a part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from ebamcheck import mesh_files, registry
from ebamcheck.config import Config, validated
from ebamcheck.curves import LIFTED, Curves, fit, fit_deviation
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.heights import checked_heights, layer_heights
from ebamcheck.inspection import inspect
from ebamcheck.layers import Layers
from ebamcheck.pipeline import fit_evidence
from ebamcheck.pipeline.certificate import (
    certificate_checks,
    find_certificate,
    read_certificate,
    run_certificate_checks,
    told_once,
)
from ebamcheck.pipeline.fit_evidence import FitVerdict
from ebamcheck.pipeline.gates import section_tolerance_mm
from ebamcheck.program import Check, verify_file
from ebamcheck.scan import ScanPlan
from ebamcheck.slicing import slice_part
from ebamcheck.store import MANIFEST, RunFolder, sha256_of_file, sha256_of_json

SMOOTH_MM = 0.002
"""Chords of the smooth sections: far under the tolerance of the fit."""


def verify(target: str | Path, part: str | Path | None = None, config: Config | None = None) -> list[Check]:
    """Check a finished run, or a program against a part, from the program's text.

    Parameters
    ----------
    target
        A run folder, or a program: the file that is started, or its folder.
    part
        File of the part; a program by itself needs it.
    config
        Settings for a program by itself; the default ones if None. A run folder has its own.

    Returns
    -------
    list of Check
        ``all(check.passed for check in checks)`` is the verdict; one that fails names file and line.

    Raises
    ------
    InputError
        If there is no such target, or it cannot be read.
    SettingsError
        If the target is no run folder and no part is given.
    """
    place, made_from = Path(target), None if part is None else Path(part)
    if (place / MANIFEST).is_file():
        return verify_run(place, made_from)
    if not place.exists():
        raise InputError(f"{place}: there is no such run folder or program")
    if made_from is None:
        raise SettingsError(f"{place}: is no run folder: to verify a program, name its part with --part")
    return verify_against_part(place, made_from, config or Config())


def verify_run(folder: Path, part: Path | None = None) -> list[Check]:
    """Check that a run folder is what it says: hashes of settings, programs and part, and the programs anew.

    Parameters
    ----------
    folder
        A finished run folder.
    part
        The part's file; without it, the part's hash is not checked.

    Raises
    ------
    InputError
        If the folder is no run folder, or its record lacks something.
    """
    run = RunFolder(folder)
    manifest = run.manifest()
    try:
        return _verify(run, manifest, part)
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(f"{folder / MANIFEST}: is not whole: {type(error).__name__} at {error}") from None


def _verify(run: RunFolder, manifest: dict[str, Any], part: Path | None) -> list[Check]:
    checks = [
        _hash_check(
            "settings unchanged",
            sha256_of_json(manifest["settings"]),
            manifest["settings_sha256"],
            "run.json",
        )
    ]
    checks += run_certificate_checks(run, manifest)
    files = [_file_check(run.path / name, name, sha256) for name, sha256 in manifest["files"].items()]
    checks += told_once(files)
    untouched = all(check.passed for check in checks)
    if part is not None:
        checks.append(_hash_check("part unchanged", _file_hash(part), manifest["part"]["sha256"], part.name))
    checks += _recorded_gates(manifest)
    if not untouched:
        # Checked by other settings or against other layers, the program would say nothing about this run.
        return checks
    record = manifest.get("program")
    if record is None and manifest.get("job") == "check":
        return checks
    if record is None:
        return [*checks, Check("program", False, 1.0, 0.0, "faults", "", "the run wrote no program")]
    config = validated(manifest["settings"], "run.json: settings")
    recorded = {file["name"]: file["sha256"] for file in record["files"]}
    checks += verify_file(
        run.program_folder / record["files"][0]["name"],
        config=config,
        curves=Curves.from_parquet(run.path / "beads.parquet"),
        plan=ScanPlan.from_parquet(run.path / "scan.parquet"),
        layers=run.read_layers(record["witness"]),
        metal=True,
        heat=True,
        sha256=recorded,
        section_tolerance_mm=section_tolerance_mm(pd.read_csv(run.path / "fit.csv"), config),
    )
    return checks


def _recorded_gates(manifest: dict[str, Any]) -> list[Check]:
    """The gates as the run recorded them."""
    return [
        Check(
            f"gate {g['name']}",
            bool(g["passed"]),
            float(g["figure"]),
            float(g["limit"]),
            g["unit"],
            "run.json",
            g["text"],
        )
        for g in manifest["gates"]
    ]


def verify_against_part(program: Path, part_path: Path, config: Config) -> list[Check]:
    """Check a program from its text alone against the part that it should make.

    The part is sliced anew at the layers of the settings, by an exact backend that did not make the program where
    its certificate says which one did. A certificate beside the program is checked, too.

    Raises
    ------
    InputError
        If the part cannot be read, there is no program at `program`, or its certificate is none.
    """
    if not program.exists():
        raise InputError(f"{program}: there is no such program")
    part = mesh_files.load(part_path, config.part.units).along(config.part.direction)
    found = inspect(part)
    sound = Check(
        "part sound",
        found.passed,
        float(not found.passed),
        0.0,
        "faults",
        part_path.name,
        f"{found.verdict}: {found.why}",
    )
    heights = checked_heights(
        layer_heights(part, config.layer_height_mm)
        if not config.layers.heights_mm
        else config.layers.heights_mm
    )
    paper = find_certificate(program)
    maker = str(read_certificate(paper).get("primary", "")) if paper else ""
    layers = slice_part(part, heights)
    curves = fit(layers, config.curves.method, config.curves, part=part)
    made = verify_file(
        program,
        config=config,
        layers=slice_part(part, heights, witness_backend(maker)),
        smooth=curves.sample_tolerance(SMOOTH_MM) if config.curves.method in LIFTED else None,
        beads=True,
        metal=True,
        heat=True,
        heights=heights,
        section_tolerance_mm=section_tolerance_mm(_fit_table(curves, layers), config),
    )
    certified = certificate_checks(paper, program, part_path, config) if paper else []
    return [*certified, sound, *made]


def _fit_table(curves: Curves, layers: Layers) -> pd.DataFrame:
    if curves.evidence is None:
        raise ValueError("curves of a fit carry its evidence")
    return fit_evidence.columns(
        FitVerdict(curves, curves.evidence, None, None), fit_deviation(curves, layers)
    )


def witness_backend(maker: str) -> str:
    """Available exact backend of the highest priority that did not make a program; `maker` if there is no other.

    Where the maker is not known it is taken to be the default one.
    """
    maker = maker or registry.default_backend()
    others = [
        name
        for name in registry.house_slicers()
        if name != maker and registry.slicer(name).exact and registry.probe(name).available
    ]
    return max(others, key=lambda name: registry.slicer(name).priority, default=maker)


def _file_check(path: Path, name: str, recorded: str) -> Check:
    """Check that a file of a run is there and is as the run wrote it."""
    if not path.is_file():
        return Check("file unchanged", False, 1.0, 0.0, "faults", name, "the file is missing")
    return _hash_check("file unchanged", _file_hash(path), recorded, name)


def _file_hash(path: Path) -> str:
    try:
        return sha256_of_file(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _hash_check(name: str, found: str, recorded: str, where: str) -> Check:
    same = found == recorded
    text = (
        f"SHA-256 {recorded[:16]}..."
        if same
        else f"SHA-256 is {found[:16]}..., recorded is {recorded[:16]}..."
    )
    return Check(name, same, float(not same), 0.0, "faults", where, text)
