"""Verification after the fact: of a finished run folder, and of a program against a part."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ebamcheck.checks.consumables import plate_checks
from ebamcheck.checks.table import mounting_checks, stands_of, turned_checks
from ebamcheck.checks.text_checks import Truth
from ebamcheck.curves import Curves, fit_for_program
from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.heat.preheating import asked_for
from ebamcheck.json_values import sha256_of_json
from ebamcheck.layers.heights import cut_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart, read_part
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.pipeline.cross_check import witness_backend
from ebamcheck.pipeline.entry_program import begins_later, entry_of_whole
from ebamcheck.pipeline.stages import smooth_sections
from ebamcheck.preflight.report import chosen_height
from ebamcheck.program import read_program, verify_file
from ebamcheck.record import certificate_checks as papers
from ebamcheck.record.certificate import find_certificate, find_record, read_certificate
from ebamcheck.record.certificate_checks import hash_check, part_hash
from ebamcheck.record.form import PLATE
from ebamcheck.record.run_folder import MANIFEST, RunFolder, own_file
from ebamcheck.record.signing import trusted_keys
from ebamcheck.result import Check, gate_of_record
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config, validated
from ebamcheck.settings.files import differences
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.verification.gates_again import compared, truth_of, work_again


def verify(
    target: str | Path, part: str | Path | None = None, config: Config | None = None, *, quick: bool = False,
    trusted: Sequence[str | Path] = (), whole: str | Path | None = None,
) -> list[Check]:  # fmt: skip
    """Check a finished run, or a program against a part, from part, settings and the program's text.

    Parameters
    ----------
    target
        A run folder, or a program: the file that is started, or its folder.
    part
        File of the part; a program by itself needs it, and a run whose part is no longer where it was.
    config
        Settings for a program by itself; None: those of the run that it lies in, else the default ones. A run
        folder has its own.
    quick
        Of a run: believe its recorded layers and gates, as far as their hashes hold, and slice nothing anew.
    trusted
        Files and folders of public keys (``*.pub``); if any are given, one of them must have signed the certificate.
    whole
        For a program that begins at a layer: the run folder or program whose end it is. That one is checked in its place, and
        all motions must be those of its end.

    Returns
    -------
    list of Check
        ``all(check.passed for check in checks)`` is the verdict; one that fails names file and line.

    Raises
    ------
    InputError
        If there is no such target, it cannot be read, or a trusted key is none.
    SettingsError
        If the target is no run folder and no part is given, or the part of a run is not found.

    Examples
    --------
    >>> import tempfile
    >>> import ebamcheck
    >>> from ebamcheck.scan import plan_stack
    >>> from ebamcheck_models import CUBE
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     part = CUBE.tessellate(0.1)
    ...     file = ebamcheck.save(part, Path(folder) / "cube.stl")
    ...     layers = ebamcheck.slice(part, [1.0, 3.0])
    ...     config = ebamcheck.Config(layers={"layer_height_mm": 2.0})
    ...     program = ebamcheck.write_program(ebamcheck.fit(layers), plan_stack(layers), config, Path(folder) / "nc")
    ...     checks = verify(program.main, file, config)
    >>> checks[0].name, checks[0].passed, all(check.passed for check in checks)
    ('part sound', True, False)
    """
    place, made_from = Path(target), None if part is None else Path(part)
    if whole is not None:
        checks = verify(whole, part, config, quick=quick, trusted=trusted)
        return [entry_of_whole(place, Path(whole), config or settings_beside(Path(whole))), *checks]
    keys = trusted_keys(trusted) if trusted else None
    if own_file(place / MANIFEST):
        return verify_run(place, made_from, quick=quick, trusted=keys)
    if not place.exists():
        raise InputError(f"{place}: there is no such run folder or program")
    if made_from is None:
        raise SettingsError(f"{place}: is no run folder: to verify a program, name its part with --part")
    checks = verify_against_part(place, made_from, config or settings_beside(place), keys)
    first = next((k for k, check in enumerate(checks) if not check.passed), None)
    if first is not None and config is None and not find_record(place):
        why = "no run lies beside the program, so the default settings were taken: name those that it was made with by --config"
        checks[first] = replace(checks[first], text=f"{checks[first].text}; {why}")
    return checks


def settings_beside(program: Path) -> Config:
    """Settings of the run that a program lies in; the default ones where it lies in none."""
    record = find_record(program)
    if record is None:
        return Config()
    return validated(RunFolder(record.parent).manifest()["settings"], f"{record}: settings")


def verify_run(
    folder: Path, part: Path | None = None, *, quick: bool = False, trusted: dict[bytes, str] | None = None
) -> list[Check]:
    """Check that a run folder is what it says: its hashes and certificate, and every gate worked out again, as :func:`verify`
    does."""
    run = RunFolder(folder)
    manifest = run.manifest()
    try:
        return _verify(run, manifest, part, quick, trusted)
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(f"{folder / MANIFEST}: is not whole: {type(error).__name__} at {error}") from None


def _verify(
    run: RunFolder, manifest: dict[str, Any], part: Path | None, quick: bool, trusted: dict[bytes, str] | None
) -> list[Check]:
    recorded = sha256_of_json(manifest["settings"])
    checks = [hash_check("settings unchanged", recorded, manifest["settings_sha256"], MANIFEST)]
    checks += papers.run_certificate_checks(run, manifest, trusted)
    checks += papers.told_once([papers.file_check(run.path / name, name, h) for name, h in manifest["files"].items()])
    # Checked by other settings or against other layers, the program would say nothing about this run.
    untouched = all(check.passed for check in checks if check.name != "signature")
    config = validated(manifest["settings"], f"{MANIFEST}: settings")
    if not quick:
        path = part or part_of_run(run, manifest)
        checks.append(hash_check("part unchanged", part_hash(path), manifest["part"]["sha256"], path.name))
        if not (untouched and checks[-1].passed):
            return checks
        return checks + compared_again(run, manifest, config, read_part(path, config.part)[0])
    if part is not None:
        checks.append(hash_check("part unchanged", part_hash(part), manifest["part"]["sha256"], part.name))
    # A quick check does not work the gates out again.
    for gate in map(gate_of_record, manifest["gates"]):
        said = f"as recorded: {gate.text}"
        checks.append(replace(gate, name=f"gate {gate.name}", where=MANIFEST, text=said))
    # A program must not be its own witness where another exact slicer came to its end.
    witness, backends = (manifest.get("program") or {}).get("witness"), manifest["backends"]
    exact = {name for name, found in backends.items() if found["exact"] and found["status"] == "done"}
    if witness is not None and witness == manifest["primary"] and exact - {witness}:
        checks.append(Check.fault("record", MANIFEST, f"{witness} is named as its own witness"))
    return checks + (_text_alone(run, manifest, config) if untouched else [])


def compared_again(run: RunFolder, manifest: dict[str, Any], config: Config, part: Part) -> list[Check]:
    """Work every gate out again, and compare with the record; what does not fit the part at all is a failed check."""
    try:
        again = work_again(run, manifest, config, part)
    except EbamcheckError as error:
        return [Check.fault("worked out again", str(run.path), str(error))]
    tables = [] if again.tables is None else [again.tables]
    if manifest.get("program") is None and manifest.get("job") != "check":
        return [*compared(again, manifest), *tables, _no_program()]
    text, record = None, manifest.get("program")
    if record and isinstance(part, PlatePart):
        with suppress(EbamcheckError):  # a program that cannot be read has a failed check of its own
            text = read_program(run.program_folder / record["files"][0]["name"], config)
    parts = plate_checks(part, config, text, manifest.get(PLATE), MANIFEST)
    return [*compared(again, manifest), *tables, *parts, *again.checks]


def part_of_run(run: RunFolder, manifest: dict[str, Any]) -> Path:
    """File of the part of a run: where it was when the run was made, else beside the run folder."""
    source = str(manifest["part"]["source"])
    places = [Path(str(manifest["timings"].get("part_path", source))), run.path.resolve().parent / source]
    for path in places:
        if path.is_file():
            return path
    raise SettingsError(
        f"{run.path}: its part {source!r} is neither at {places[0]} nor beside the run: name it with --part, "
        "or ask for --quick, which slices nothing anew"
    )


def _text_alone(run: RunFolder, manifest: dict[str, Any], config: Config) -> list[Check]:
    """Check the program's text against the layers, curves and plan that the run recorded."""
    record = manifest.get("program")
    if record is None:
        return [] if manifest.get("job") == "check" else [_no_program()]
    main = run.program_folder / record["files"][0]["name"]
    hashes = {file["name"]: file["sha256"] for file in record["files"]}
    smooth = smooth_sections(Curves.from_parquet(run.path / "curves.parquet"), config)
    curves = Curves.from_parquet(run.path / "beads.parquet")
    plan = ScanPlan.from_parquet(run.path / "scan.parquet")
    # Of the solid nothing is known here: a quick check needs no part.
    return verify_file(
        main, config=config, curves=curves, plan=plan, layers=run.read_layers(record["witness"]), smooth=smooth, metal=True,
        heat=True, sha256=hashes, truth=truth_of(manifest),
    )  # fmt: skip


def _no_program() -> Check:
    return Check.fault("program", "", "the run wrote no program")


def verify_against_part(
    program: Path, part_path: Path, config: Config, trusted: dict[bytes, str] | None = None
) -> list[Check]:
    """Check a program from its text alone against the part that it should make, and the certificate beside it, if there is one.

    The part is sliced anew at the layers of a run with these settings, by an exact backend that did not make the program.
    """
    if not program.exists():
        raise InputError(f"{program}: there is no such program")
    part, _ = read_part(part_path, config.part)
    found = inspect(part)
    said = f"{found.verdict}: {found.why}"
    sound = Check("part sound", found.passed, float(not found.passed), 0.0, "faults", part_path.name, said)
    config = chosen_height(part, found.passed, config).config
    heights = cut_heights(part, config)
    paper = find_certificate(program)
    maker = str(read_certificate(paper).get("primary", "")) if paper else ""
    layers = slice_part(part, heights)
    witness = slice_part(part, heights, witness_backend(maker))
    curves = fit_for_program(layers, config.curves, part)
    said_validated = read_certificate(paper).get("validated") if paper else None
    given, differ = sha256_of_json(config.model_dump()), list[str]()
    if find_record(program) is not None:
        with suppress(EbamcheckError):  # a record that cannot be read says nothing of the program
            differ = differences(config, settings_beside(program))
    truth = Truth(said_validated, part_hash(part_path), given_sha256=given, differences=tuple(differ))
    under = None
    if config.base_mm != 0.0 and asked_for(0, config):
        # What the program begins on and preheats: half a layer under its bottom.
        cut_mm = max(float(heights[0]) - config.layer_height_mm, float(part.bounds[0, 2]))
        under = slice_part(part, [cut_mm], witness_backend(maker)).section(0)
    made = verify_file(
        program, config=config, part=part, layers=witness, smooth=smooth_sections(curves, config), beads=True, metal=True,
        heat=True, under=under, heights=heights, truth=truth,
    )  # fmt: skip
    if not all(check.passed for check in made):
        z_of = deposition_heights(heights, config.layer_height_mm, config.base_mm)
        made = [*begins_later(program, z_of, config), *made]
    certified = papers.certificate_checks(paper, program, part_path, config, trusted) if paper else []
    if paper and isinstance(part, PlatePart):
        with suppress(EbamcheckError):  # a program that cannot be read has a failed check of its own
            text = read_program(program, config)
            certified += plate_checks(part, config, text, read_certificate(paper).get(PLATE), paper.name)
    return [*certified, sound, *_turned(program, part_path, part, witness, config), *made]


def _turned(program: Path, path: Path, part: Part, layers: Layers, config: Config) -> list[Check]:
    """Check a part that is turned on a tilt table, by its mesh: its mounting, and what stands; nothing for a part that is not
    turned."""
    said = config.part.on_table
    if said is None:
        return []
    upright = config.changed(part={"direction": said.direction, "on_table": None})
    before = read_part(path, upright.part)[0]
    # A program that cannot be read, or a part of another file, has a failed check of its own.
    with suppress(EbamcheckError):
        stands = stands_of(before, part, said.built_mm, config)
        section = layers.section(0)
        return turned_checks(read_program(program, config), section, float(layers.heights[0]), stands, config)
    return mounting_checks(before, part, config)
