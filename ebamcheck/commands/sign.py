"""``ebamcheck key`` and ``ebamcheck sign``: who stands for a run, by a signature that nobody else can make."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ebamcheck.commands.options import explained
from ebamcheck.errors import ExitCode
from ebamcheck.printable import printable
from ebamcheck.record.certificate import CERTIFICATE, lots_of, read_certificate, released
from ebamcheck.record.certificate_checks import refuse_unfit
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.record.signing import SIGNATURES, asked_password, make_key, read_private_key, sign


def key_command(
    name: Annotated[Path, Argument(help="NAME.key (private, mode 600) and NAME.pub are made.")],
    protect: Annotated[bool, Option("--protect", help="Ask for a password for the private key.")] = False,
) -> ExitCode:
    """Make a pair of Ed25519 keys: the private one signs, the public one goes to those who verify.

    Example: ebamcheck key keys/jane
    """
    password = typer.prompt("password", hide_input=True, confirmation_prompt=True) if protect else ""
    private, public = make_key(name, password)
    typer.echo(f"{private}: keep it; whoever has it signs as you\n{public}: give it to those who verify")
    return ExitCode.PASS


@explained(
    lot="NAME=NUMBER of a lot, such as wire=W-1234. May be given again.",
    deviation="A deviation that is accepted. May be given again.",
)
def sign_command(
    run: Path,
    key: Annotated[Path, Option(help="Private key (PEM), made by `ebamcheck key`.")],
    name: Annotated[str, Option(help="Name of who signs.")],
    role: Annotated[str, Option(help="What he or she signs as.")] = "approver",
    part_number: Annotated[str, Option(help="Number of the part.")] = "",
    revision: Annotated[str, Option(help="Revision of the part.")] = "",
    machine_serial: Annotated[str, Option(help="Serial number of the machine.")] = "",
    lot: list[str] | None = None,
    operator: Annotated[str, Option(help="Who runs the build.")] = "",
    approver: Annotated[str, Option(help="Who releases it; default: NAME, if the role is approver.")] = "",
    date: Annotated[str, Option(help="Date of the release, as your records write it.")] = "",
    deviation: list[str] | None = None,
) -> ExitCode:
    """Add part number, lots, approver and deviations to a run's certificate, and sign it.

    The seal and every signature cover all of it: what is changed afterwards breaks them. Further people sign with
    their own keys and without further values.

    Example: ebamcheck sign blade.run --key keys/jane.key --name "Jane Doe" --part-number B-17 --lot wire=W-1234
    """
    path = run / CERTIFICATE
    refuse_unfit(RunFolder(run))
    numbers = {"part_number": part_number, "revision": revision, "machine_serial": machine_serial}
    people = {"operator": operator, "approver": approver, "date": date, "deviations": deviation or []}
    given: dict[str, Any] = {**numbers, "lots": lots_of(lot or []), **people}
    release = {field: value for field, value in given.items() if value}
    if role == "approver" and not approver and not read_certificate(path)["release"]["approver"]:
        release["approver"] = name
    signer = read_private_key(key, asked_password(key))
    file = sign(released(path, release), signer, name, role)
    said = read_certificate(path)
    typer.echo(printable(f"{run / SIGNATURES / file.name}: {name} signed as {role}"))
    if not said["validated"]:
        typer.echo("note: this run is NOT VALIDATED; the certificate says so")
    return ExitCode.PASS
