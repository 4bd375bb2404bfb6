"""``ebamcheck verify``: a finished run, or a program against a part."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.commands.options import (
    DEFAULT_CONFIG,
    ConfigOption,
    JsonOption,
    LayerHeightOption,
    UnitsOption,
    print_json,
    settings_of,
)
from ebamcheck.errors import ExitCode, SettingsError


def verify(
    target: Annotated[
        Path, typer.Argument(help="A run folder; or, with --part, a program, or the folder of a live build.")
    ],
    part: Annotated[
        Path | None,
        typer.Option(help="File of the part that the program should make; of a run: if it was moved since."),
    ] = None,
    whole: Annotated[
        Path | None,
        typer.Option(
            help="Of a program that begins at a layer (--from-layer): the run folder or program that it is the end of."
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Of a run: believe its recorded layers and gates, slice nothing anew."),
    ] = False,
    trusted: Annotated[
        list[Path] | None,
        typer.Option(help="Public key, or a folder of them; one must have signed. May be given again."),
    ] = None,
    config_file: ConfigOption = None,
    layer_height: LayerHeightOption = None,
    units: UnitsOption = "",
    as_json: JsonOption = False,
) -> ExitCode:
    """Work every gate of a finished run out again, or check a program against a part, from the program's text."""
    from ebamcheck.drawing.tables import text_table
    from ebamcheck.live.verifying import holds_layers
    from ebamcheck.record.certificate import find_record
    from ebamcheck.record.run_folder import MANIFEST
    from ebamcheck.result import check_record
    from ebamcheck.verification import verify as verification

    if holds_layers(target):
        return _build(target, part, as_json)
    # A run has its own settings: a file that lies about does not matter to it, nor to a program in it.
    main = whole or target
    own = (main / MANIFEST).is_file()
    if not own and main.exists() and not (config_file or units or layer_height):
        own = find_record(main) is not None
    default = not (config_file or units or layer_height or DEFAULT_CONFIG.is_file())
    config = None if own or default else settings_of(config_file, units, "", layer_height)
    checks = verification.verify(target, part, config, quick=quick, trusted=trusted or (), whole=whole)
    if as_json:
        print_json([check_record(check) for check in checks])
    else:
        rows = [
            ["pass" if c.passed else "FAIL", c.name, c.value, c.limit, c.unit, c.where, c.text]
            for c in checks
        ]
        print(text_table(["", "check", "value", "limit", "unit", "where", ""], rows))
        failed = sum(not c.passed for c in checks)
        print(f"\n{len(checks) - failed} of {len(checks)} checks passed")
    return ExitCode.PASS if all(c.passed for c in checks) else ExitCode.OUT_OF_TOLERANCE


def _build(folder: Path, part: Path | None, as_json: bool) -> ExitCode:
    """Verify every published layer of a live build from its text alone."""
    from ebamcheck.live.verifying import VerifiedLayer, verify_build

    if part is None:
        raise SettingsError(
            f"{folder}: holds layers of a live build, or of `ebamcheck relayer`: name the part with --part"
        )

    def tell(layer: VerifiedLayer) -> None:
        if not as_json:
            print(
                f"{'pass' if layer.passed else 'FAIL'}  {layer.name}  {layer.checks} checks  {layer.why}".rstrip()
            )

    found = verify_build(folder, part, tell)
    good = sum(layer.passed for layer in found)
    if as_json:
        print_json([vars(layer) for layer in found])
    else:
        print(f"\n{good} of {len(found)} published layers verify from their text alone")
    return ExitCode.PASS if found and good == len(found) else ExitCode.OUT_OF_TOLERANCE
