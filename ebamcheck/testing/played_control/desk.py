"""Both sides of a connection on a desk: keys, certificates, a user and a profile for the door; and the whole played control."""

from __future__ import annotations

import asyncio
import datetime
import ipaddress
import os
import secrets
import threading
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ebamcheck.atomic_file import made_folder
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.settings.opcua import OpcuaSettings
from ebamcheck.testing.played_control.program import FAULTS, PlayedProgram
from ebamcheck.testing.played_control.server import SESSIONS, Access, PlayedServer

PROFILE, PASSWORD = "opcua.toml", "password"  # files of a desk's folder
USER = "ebamcheck"


def desk_profile(folder: Path, opcua: OpcuaSettings) -> Access:
    """Make keys, certificates, a user and a profile in a folder; what is there already is used again."""
    made_folder(folder)
    host = urlsplit(opcua.url).hostname or "127.0.0.1"
    for name, uri in (("server", "urn:ebamcheck:machine"), ("client", opcua.application_uri)):
        if not (folder / f"{name}.pem").is_file():
            _certificate(folder, name, uri, host)
    password = folder / PASSWORD
    if not password.is_file():
        _write_own(password, secrets.token_urlsafe(18).encode())
    place = folder.resolve()
    lines = [
        "# Made by `ebamcheck machine RUN --opcua` for a desk: use it with `ebamcheck live RUN --opcua --config THIS`.",
        "[opcua]",
        f'url = "{opcua.url}"',
        'security = "sign_and_encrypt"',
        f'certificate = "{place / "client.pem"}"',
        f'private_key = "{place / "client-key.pem"}"',
        f'server_certificate = "{place / "server.pem"}"',
        f'user = "{USER}"',
        f'password_file = "{place / PASSWORD}"',
        "",
    ]
    (folder / PROFILE).write_text("\n".join(lines), encoding="utf-8")
    server, key, client = (folder / name for name in ("server.pem", "server-key.pem", "client.pem"))
    return Access(server, key, client, USER, password.read_text().strip())


def _certificate(folder: Path, name: str, uri: str, host: str) -> None:
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"ebamcheck {name}")])
    now = datetime.datetime.now(datetime.UTC)
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(uri)]
    try:
        names.append(x509.IPAddress(ipaddress.ip_address(host)))
    except ValueError:
        names.append(x509.DNSName(host))
    usage = x509.KeyUsage(True, True, True, True, False, True, False, False, False)
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(minutes=5))
        .not_valid_after(now + datetime.timedelta(days=365))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=False)
        .add_extension(usage, critical=False)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    text = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    _write_own(folder / f"{name}-key.pem", text)
    (folder / f"{name}.pem").write_bytes(made.public_bytes(pem))


def _write_own(path: Path, content: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)


def faults_of(texts: list[str]) -> dict[int, tuple[str, ...]]:
    """Faults by layer, of texts such as ``away@3``.

    >>> faults_of(["away@3", "late@3", "reset@5"])
    {3: ('away', 'late'), 5: ('reset',)}
    """
    found: dict[int, tuple[str, ...]] = {}
    for text in texts:
        name, _, layer = text.partition("@")
        if name not in FAULTS or not (layer.isascii() and layer.isdigit() and int(layer) > 0):
            raise SettingsError(
                f"--fault {text!r}: give NAME@LAYER, with the layer from 1 and a name of {', '.join(FAULTS)}"
            )
        found[int(layer)] = (*found.get(int(layer), ()), name)
    return found


async def played(
    program: PlayedProgram,
    access: Access | None,
    sessions: int = SESSIONS,
    listens: Callable[[], None] = lambda: None,
) -> None:
    """Play a control until its program ends; `listens` is called when it can be reached."""
    opcua, loop = program.opcua, asyncio.get_running_loop()
    server = PlayedServer(program.panel, program.config.machine, opcua, access, sessions)
    program.act = lambda away_s, full_s: asyncio.run_coroutine_threadsafe(server.away(away_s, full_s), loop)
    try:
        async with server.serving():
            listens()
            await _in_thread(program)
            await asyncio.sleep(2.0)  # somebody reads the last values
    except OSError as error:
        raise InputError(f"{opcua.url}: cannot listen there: {error.strerror or error}") from None


async def _in_thread(program: PlayedProgram) -> None:
    """Run the program in a thread that an interrupt does not wait for."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[None] = loop.create_future()

    def settle(error: BaseException | None) -> None:
        if not future.done():
            future.set_exception(error) if error else future.set_result(None)

    def run() -> None:
        error: BaseException | None = None
        try:
            program.run()
        except BaseException as raised:
            error = raised
        if not loop.is_closed():
            loop.call_soon_threadsafe(settle, error)

    threading.Thread(target=run, name="played program", daemon=True).start()
    try:
        await future
    finally:
        program.stopped = True
