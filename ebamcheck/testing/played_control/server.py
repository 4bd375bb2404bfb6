"""A played control as an OPC UA server: R parameters on a grid of 100 ms, file upload, users, rights, a limit of sessions;
and the keys, profile and faults to try it with."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import ipaddress
import os
import secrets
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ebamcheck.atomic_file import made_folder
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.live.opcua.handshake import OFFSETS
from ebamcheck.live.opcua.link import cancelled
from ebamcheck.settings.machine import TEXT_ROLES, MachineSettings, OpcuaSettings
from ebamcheck.testing.played_control.program import FAULTS, Panel, PlayedProgram

GRID_S = 0.1  # grid on which a SINUMERIK samples its values
SESSIONS = 10  # sessions of a SINUMERIK's server
AWAY_S = 1.0  # time for which a server is away that broke in the middle of an upload


@dataclass(frozen=True)
class Access:
    """Who may connect to the played control: a certificate and a user; None: anybody, unprotected."""

    certificate: Path
    private_key: Path
    client_certificate: Path
    user: str
    password: str


class PlayedServer:
    """The server in front of a panel; `async with serving()` keeps it up, and it may go away and come back."""

    def __init__(
        self,
        panel: Panel,
        machine: MachineSettings,
        opcua: OpcuaSettings,
        access: Access | None,
        sessions: int = SESSIONS,
    ) -> None:
        self.panel, self._machine, self._opcua = panel, machine, opcua
        self._access, self._sessions = access, sessions
        self._server: Any = None
        self.broke = asyncio.Event()
        self._from_within = False
        self._closing = False

    async def start(self) -> None:
        """Come up, with the values and files of the panel."""
        from asyncua import ua
        from asyncua.server.internal_session import InternalSession
        from asyncua.server.server import Server

        server = Server(user_manager=cast(Any, _Users(self._access)))
        await server.init()
        server.set_endpoint(self._opcua.url)
        server.set_server_name("ebamcheck machine")
        if self._access is None:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        else:
            server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
            server.set_identity_tokens([ua.UserNameIdentityToken])
            await server.load_certificate(self._access.certificate)
            await server.load_private_key(self._access.private_key)
            server.set_certificate_validator(self._known_certificate)
        await server.register_namespace("SinumerikVarProvider")

        async def variable(place: str, name: str, value: Any, setter: Any) -> Any:
            node_id = ua.NodeId.from_string(place)
            node = await server.nodes.objects.add_variable(node_id, name, value)
            await node.set_writable()
            server.set_attribute_value_setter(node_id, setter)
            return node

        self._nodes: dict[int, Any] = {}
        for n in range(self._machine.live_r, self._machine.live_r + 1 + max(OFFSETS.values())):
            place = self._opcua.r_node.replace("{r}", str(n))
            self._nodes[n] = await variable(place, f"R{n}", self.panel.get(n), self._setter(n))
        for role, place in self._opcua.nodes.items():
            if role in TEXT_ROLES:
                await variable(place, role, self.panel.texts.get(role, ""), self._text_setter(role))
        node_id = ua.NodeId.from_string(self._opcua.methods_node)
        methods = await server.nodes.objects.add_object(node_id, "Methods")
        text, data, flag = ua.VariantType.String, ua.VariantType.ByteString, ua.VariantType.Boolean
        upload, download = map(ua.NodeId.from_string, (self._opcua.upload_node, self._opcua.download_node))
        await methods.add_method(upload, "CopyFileToServer", self._upload, [text, data, flag], [])
        await methods.add_method(download, "CopyFileFromServer", self._download, [text], [data])
        # The library counts sessions over all servers of a process, which has this one alone.
        InternalSession.max_connections = self._sessions
        await server.start()
        self._server = server

    async def stop(self) -> None:
        """End for good."""
        server, self._server = self._server, None
        if server is not None:
            with contextlib.suppress(Exception):
                await server.stop()

    @asynccontextmanager
    async def serving(self) -> AsyncIterator[PlayedServer]:
        """Be up, and show the panel on its grid."""
        self._closing = False
        await self.start()
        task = asyncio.create_task(self._show())
        try:
            yield self
        finally:
            # The library may lose a cancellation while it takes a server down: whether to go on is asked, too.
            self._closing = True
            try:
                while not task.done():
                    await cancelled(task)
            finally:
                await self.stop()

    async def away(self, seconds: float, full_s: float = 0.0) -> None:
        """Be away for `seconds`, like a control that is switched off; then refuse every new session for `full_s`."""
        from asyncua.server.binary_server_asyncio import BinaryServer
        from asyncua.server.internal_session import InternalSession

        server = self._server
        if server is None:
            return
        await server.bserver.stop()
        await asyncio.sleep(seconds)
        if self._closing:
            return
        InternalSession.max_connections = 0 if full_s else self._sessions
        url = urlsplit(self._opcua.url)
        host, port = url.hostname or "127.0.0.1", url.port or 4840
        server.bserver = BinaryServer(server.iserver, host, port, server.limits)
        server.bserver.set_policies(server._policies)
        await server.bserver.start()
        if full_s:
            await asyncio.sleep(full_s)
            InternalSession.max_connections = self._sessions

    async def _show(self) -> None:
        """Copy what has changed in the panel to the nodes, every 100 ms; go away where an upload asks for it."""
        from asyncua import ua

        shown: dict[int, float] = {}
        while not self._closing:
            await asyncio.sleep(GRID_S)
            if self.broke.is_set():
                self.broke.clear()
                await self.away(AWAY_S)
            server = self._server
            if server is None:
                continue
            for number, value in dict(self.panel.values).items():
                if number in self._nodes and repr(shown.get(number)) != repr(value):
                    shown[number] = value
                    data = ua.DataValue(ua.Variant(value, ua.VariantType.Double))
                    self._from_within = True
                    try:
                        await server.write_attribute_value(self._nodes[number].nodeid, data)
                    finally:
                        self._from_within = False

    def _setter(self, number: int) -> Any:
        from asyncua import ua
        from asyncua.common.utils import ServiceError

        def write(node: Any, attribute: Any, value: Any) -> None:
            if not self._from_within:
                if self.panel.rights == "refused":
                    raise ServiceError(_status("BadUserAccessDenied").value)
                now = self.panel.write(number, float(value.Value.Value))
                value = ua.DataValue(ua.Variant(now, ua.VariantType.Double))
            node.attributes[attribute].value = value

        return write

    def _text_setter(self, role: str) -> Any:
        def write(node: Any, attribute: Any, value: Any) -> None:
            if self.panel.rights == "operate":
                self.panel.texts[role] = str(value.Value.Value or "")
                node.attributes[attribute].value = value

        return write

    async def _upload(self, parent: Any, path: Any, data: Any, replace: Any) -> Any:
        place, content = str(path.Value), bytes(data.Value or b"")
        if self.panel.rights == "refused":
            return _status("BadUserAccessDenied")
        if place in self.panel.files and not replace.Value:
            return _status("BadBrowseNameDuplicated")
        if self.panel.upload(place, content):
            self.broke.set()
            await asyncio.sleep(5.0 * AWAY_S)  # it does not outlive the server
        return []

    async def _download(self, parent: Any, path: Any) -> Any:
        from asyncua import ua

        found = self.panel.files.get(str(path.Value))
        if found is None:
            return _status("BadNotFound")
        return [ua.Variant(found, ua.VariantType.ByteString)]

    async def _known_certificate(self, certificate: Any, description: Any) -> None:
        from asyncua.common.utils import ServiceError

        assert self._access is not None
        known = x509.load_pem_x509_certificate(self._access.client_certificate.read_bytes())
        der = serialization.Encoding.DER
        if certificate.public_bytes(der) != known.public_bytes(der):
            raise ServiceError(_status("BadCertificateUntrusted").value)


def _status(name: str) -> Any:
    from asyncua import ua
    from asyncua.ua.status_codes import StatusCodes

    return ua.StatusCode(getattr(StatusCodes, name))


class _Users:
    """One user with a password; or anybody, where there is no access to be kept."""

    def __init__(self, access: Access | None) -> None:
        self._access = access

    def get_user(self, iserver: Any, username: str | None = None, password: Any = None, certificate: Any = None) -> Any:
        from asyncua.crypto.permission_rules import User, UserRole

        if self._access is None:
            return User(role=UserRole.User)
        given = password.decode() if isinstance(password, bytes) else str(password or "")
        if username == self._access.user and secrets.compare_digest(given.encode(), self._access.password.encode()):
            return User(role=UserRole.User, name=username)
        return None


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
