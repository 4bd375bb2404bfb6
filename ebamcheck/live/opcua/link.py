"""A connection to the control: certificates, reading, writing and reading back, files, and in one line what went wrong."""

from __future__ import annotations

import asyncio
import datetime
import logging
import os
from collections.abc import Awaitable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.live.opcua.handshake import Seen, file_path, node_ids
from ebamcheck.settings.machine import ROLES, WARMTH_ROLES, MachineSettings, OpcuaSettings
from ebamcheck.showing.plotting import missing

if TYPE_CHECKING:
    from asyncua.client.client import Client

FILES = ("certificate", "private_key", "server_certificate")  # files that a protected channel needs
T = TypeVar("T")
# Kinds of status codes, by how they begin
LOGIN = ("BadIdentityTokenInvalid", "BadIdentityTokenRejected", "BadUserAccessDenied", "BadSecurityChecksFailed", "BadCertificate")  # fmt: skip
FULL = ("BadTooManySessions", "BadMaxConnectionsReached", "BadTooManySubscriptions", "BadTooManyMonitoredItems")  # fmt: skip
GONE = ("BadSession", "BadConnection", "BadServer", "BadShutdown", "BadSecureChannel", "BadTcp", "BadCommunication", "BadTimeout", "BadRequestTimeout")  # fmt: skip
# Status codes of what is not taken: code and reason of the refusal
REFUSALS = {
    ("BadUserAccessDenied", "BadNotWritable", "BadWriteNotSupported", "BadSecurityModeInsufficient"):
        ("rights", "{what} is refused ({name}): the user has no operate right on the control"),
    ("BadNodeIdUnknown", "BadNodeIdInvalid", "BadMethodInvalid", "BadNothingToDo"):
        ("node", "{what}: the control has no such node ({name}): see the section opcua of the settings"),
    ("BadNotFound", "BadNoMatch", "BadFileNotFound"): ("no-file", "{what}: there is no such file"),
    ("BadBrowseNameDuplicated", "BadEntryExists", "BadNodeIdExists"):
        ("file-exists", "{what}: a file of that name is there already"),
}  # fmt: skip


class LinkLost(EbamcheckError):
    """The control is not there, or has gone."""


class NotTaken(EbamcheckError):
    """The control is there and does not do what it was asked for; `code` says what kind of refusal it is."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


class LoginRefused(EbamcheckError):
    """The control does not let us in: certificate, user or password."""


def checked(opcua: OpcuaSettings) -> None:
    """Refuse settings with which nothing could be written, or a machine without asyncua, before anything is begun."""
    installed()
    if opcua.problem:
        raise SettingsError(opcua.problem)
    if opcua.security != "none":
        for key in FILES:
            _loaded(opcua, key)
        check_pair(opcua)
        if opcua.user:
            password_of(opcua)


def installed() -> None:
    """Refuse a machine without asyncua, and keep its log off the terminal: what matters is told by us, in one line."""
    try:
        import asyncua  # noqa: F401
    except ImportError:
        raise missing("asyncua", "opcua", "--opcua") from None
    logging.getLogger("asyncua").setLevel(logging.CRITICAL + 1)


def password_of(opcua: OpcuaSettings) -> str:
    """Password of the user, from the environment or from a file that nobody else may read."""
    if found := os.environ.get(opcua.password_variable, ""):
        return found
    if not opcua.password_file:
        what = f"it holds the password of {opcua.user!r}; or give opcua.password_file"
        raise SettingsError(f"the environment variable {opcua.password_variable} is not set: {what}")
    path = Path(opcua.password_file)
    try:
        if path.stat().st_mode & 0o077:
            raise SettingsError(f"opcua.password_file {path}: others may read it: chmod 600 {path}")
        return path.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise SettingsError(f"opcua.password_file {path}: cannot be read: {error.strerror}") from None


def _loaded(opcua: OpcuaSettings, key: str) -> tuple[bytes, str, Any]:
    """Content of the file of a certificate or key, its form, and what it holds."""
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization

    path = Path(str(getattr(opcua, key)))
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SettingsError(f"opcua.{key} {str(path)!r}: cannot be read: {error.strerror}") from None
    form = "pem" if b"-----BEGIN" in content else "der"
    try:
        if key == "private_key":
            return content, form, getattr(serialization, f"load_{form}_private_key")(content, None)
        return content, form, getattr(x509, f"load_{form}_x509_certificate")(content)
    except (ValueError, TypeError):
        what = "key without a password" if key == "private_key" else "certificate"
        raise SettingsError(f"opcua.{key} {str(path)!r}: is no {what} in PEM or DER") from None


def check_pair(opcua: OpcuaSettings) -> None:
    """Refuse a key of another certificate, one that has run out, or one of another `application_uri`."""
    from cryptography import x509

    key, own = (_loaded(opcua, name)[2] for name in ("private_key", "certificate"))
    if key.public_key() != own.public_key():
        what = f"is not the key of opcua.certificate {opcua.certificate!r}: give the two of one pair"
        raise SettingsError(f"opcua.private_key {opcua.private_key!r}: {what}")
    try:
        names = own.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    except x509.ExtensionNotFound:
        uris = []
    if opcua.application_uri not in uris:
        own_uri = f"opcua.application_uri is {opcua.application_uri!r}: a control refuses what is not alike"
        said = f"is for {', '.join(uris) or 'no URI'}, {own_uri}"
        raise SettingsError(f"opcua.certificate {opcua.certificate!r}: {said}")
    now = datetime.datetime.now(datetime.UTC)
    for setting in ("certificate", "server_certificate"):
        found, file = _loaded(opcua, setting)[2], getattr(opcua, setting)
        first, last = found.not_valid_before_utc, found.not_valid_after_utc
        if not first <= now <= last:
            said = f"holds from {first:%Y-%m-%d} to {last:%Y-%m-%d}, today is {now:%Y-%m-%d}"
            raise SettingsError(f"opcua.{setting} {file!r}: {said}")


def is_offered(opcua: OpcuaSettings, shown: Iterable[bytes]) -> bool:
    """Whether the certificate that was given for the control is among those that it shows, in DER."""
    from cryptography.hazmat.primitives.serialization import Encoding

    # What is shown may be a chain, with the certificate itself first.
    given = _loaded(opcua, "server_certificate")[2].public_bytes(Encoding.DER)
    return any(found.startswith(given) for found in shown)


class BrokenOff(Exception):
    """What was waited for was cancelled from within: the library does so with all requests when a connection breaks."""


async def within(asked: Awaitable[T], limit_s: float) -> T:
    """Wait for a result in a task of its own, and never lose a cancellation; before Python 3.12 ``asyncio.wait_for`` does, and
    asyncua.

    Raises TimeoutError where it takes longer and is cancelled then, BrokenOff where it was cancelled, and not by the one who waits.
    """
    task = asyncio.ensure_future(asked)
    try:
        await asyncio.wait([task], timeout=limit_s)
        if not task.done():
            await cancelled(task)
            raise TimeoutError
    except asyncio.CancelledError:
        await cancelled(task)
        raise
    if task.cancelled():
        raise BrokenOff
    return task.result()


async def cancelled(task: asyncio.Future[T]) -> None:
    """Cancel a task and give it a while to wind up; what it says then is of no interest."""
    # Its exception is taken, so that nobody is told that it never was.
    task.add_done_callback(lambda ended: ended.cancelled() or ended.exception())
    task.cancel()
    await asyncio.wait([task], timeout=1.0)


class Link:
    """A connection, opened by `async with`; each method raises LinkLost where the control does not answer, NotTaken where it
    refuses."""

    def __init__(self, machine: MachineSettings, opcua: OpcuaSettings) -> None:
        self._machine, self._opcua = machine, opcua
        self._ids = node_ids(machine, opcua)
        self._client: Client | None = None
        self.changed = asyncio.Event()

    async def __aenter__(self) -> Link:
        """Connect, log in and subscribe."""
        from asyncua.client.client import Client

        opcua = self._opcua
        client = Client(opcua.url, timeout=opcua.request_s)
        client.session_timeout = 60_000  # ms, that of a SINUMERIK
        client.application_uri = opcua.application_uri
        client.name = client.description = "ebamcheck live"
        try:
            await self._answered(self._connect(client), "the connection", connecting=True)
            self._client = client
            await self._answered(self._subscribe(client), "the subscription", connecting=True)
        except BaseException:
            await self._drop(client)
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        """Log out, if anybody is there to hear it."""
        if self._client is not None:
            await self._drop(self._client)
        self._client = None

    async def _connect(self, client: Client) -> None:
        from asyncua import ua
        from asyncua.crypto import security_policies
        from asyncua.crypto.uacrypto import CertProperties

        opcua = self._opcua
        if opcua.security != "none":
            await self._meet(client)
            mode = {"sign": "Sign", "sign_and_encrypt": "SignAndEncrypt"}[opcua.security]
            own, key, control = (CertProperties(*_loaded(opcua, name)[:2]) for name in FILES)
            # The certificate of the control is given: that of whoever answers is not asked for.
            policy = getattr(security_policies, f"SecurityPolicy{opcua.policy}")
            mode = getattr(ua.MessageSecurityMode, mode)
            await client.set_security(policy, own, key, server_certificate=control, mode=mode)
            if opcua.user:
                client.set_user(opcua.user)
                client.set_password(password_of(opcua))
        await client.connect()

    async def _meet(self, client: Client) -> None:
        """Hold the certificate that the control shows against the one that was given, before anything is encrypted for it."""
        try:
            ends = await client.connect_and_get_server_endpoints()
            shown = [bytes(found.ServerCertificate or b"") for found in ends]
        except Exception:
            return  # A control that shows nothing to strangers: the channel itself tells, in its own way.
        if any(shown) and not is_offered(self._opcua, shown):
            raise LoginRefused(
                f"{self._opcua.url}: shows another certificate than opcua.server_certificate {self._opcua.server_certificate!r}: "
                "copy that of the control anew, if it was changed there, or give the address of the right one"
            )

    async def _subscribe(self, client: Client) -> None:
        subscription = await client.create_subscription(1000.0 * self._opcua.grid_s, _Told(self.changed))
        watched = [role for role in ROLES if role not in ("number", "wait", "digest", "key", "seal")]
        await subscription.subscribe_data_change([client.get_node(self._ids[role]) for role in watched])

    async def _drop(self, client: Client) -> None:
        # A server that has gone hears nothing; what matters is that our side is closed, and that who is cancelled meanwhile ends.
        try:
            with suppress(Exception):
                await within(client.disconnect(), self._opcua.request_s)
        finally:
            with suppress(Exception):
                client.disconnect_socket()

    async def seen(self) -> Seen:
        """Read all values at once."""
        roles = (role for role in (*ROLES, "map", *WARMTH_ROLES) if role in self._ids)
        return Seen.of(await self._read({role: self._ids[role] for role in roles}))

    async def _read(self, ids: Mapping[str, str]) -> dict[str, Any]:
        client = self._there()
        nodes = [client.get_node(node) for node in ids.values()]
        found = await self._answered(client.read_attributes(nodes), f"reading {', '.join(ids)}")
        values: dict[str, Any] = {}
        for (role, node), value in zip(ids.items(), found, strict=True):
            status = value.StatusCode
            if status is not None and status.name == "BadNodeIdUnknown":
                said = f"the control has no node {node!r} ({role}): set opcua.nodes or opcua.r_node"
                raise NotTaken("node", said)
            good = status is None or status.is_good()
            values[role] = value.Value.Value if good and value.Value is not None else None
        return values

    async def write(self, role: str, value: float) -> None:
        """Write a number and read it back: without the right, a write can be lost without an error."""
        await self.write_all({role: float(value)})

    async def write_all(self, values: Mapping[str, float | str]) -> None:
        """Write several values at once and read them back; texts only where the control has nodes for them."""
        from asyncua import ua

        client = self._there()
        given = {role: value for role, value in values.items() if role in self._ids}
        ids = {role: self._ids[role] for role in given}
        kinds = {float: ua.VariantType.Double, str: ua.VariantType.String}
        data = [ua.DataValue(ua.Variant(value, kinds[type(value)])) for value in given.values()]
        nodes = [client.get_node(node) for node in ids.values()]
        await self._answered(client.write_values(nodes, data), f"writing {', '.join(given)}")
        for role, found in (await self._read(ids)).items():
            if found != given[role]:
                said = f"{role} was written as {given[role]!r} and reads {found!r}"
                raise NotTaken("write-lost", f"{said}: the control takes no writes, or another writes to it")

    async def upload(self, name: str, data: bytes, replace: bool) -> None:
        """Write a file."""
        from asyncua import ua

        await self._call(
            self._opcua.upload_node, f"uploading {name}",
            ua.Variant(file_path(self._machine, self._opcua, name), ua.VariantType.String),
            ua.Variant(data, ua.VariantType.ByteString), ua.Variant(replace, ua.VariantType.Boolean),
        )  # fmt: skip

    async def download(self, name: str) -> bytes | None:
        """Read a file back; None where there is none."""
        from asyncua import ua

        path = ua.Variant(file_path(self._machine, self._opcua, name), ua.VariantType.String)
        try:
            found = await self._call(self._opcua.download_node, f"reading {name} back", path)
        except NotTaken as error:
            if error.code == "no-file":
                return None
            raise
        if not isinstance(found, bytes):
            raise NotTaken("other-file", f"reading {name} back gave {type(found).__name__}, no file")
        return found

    async def _call(self, method: str, what: str, *arguments: Any) -> Any:
        from asyncua import ua

        client = self._there()
        parent = client.get_node(self._opcua.methods_node)
        return await self._answered(parent.call_method(ua.NodeId.from_string(method), *arguments), what)

    def _there(self) -> Client:
        if self._client is None:
            raise LinkLost(f"{self._opcua.url}: not connected")
        return self._client

    async def _answered(self, asked: Awaitable[T], what: str, connecting: bool = False) -> T:
        """Wait for an answer; every fault becomes one of ours."""
        url = self._opcua.url
        try:
            # The client has its own limit of a request; this one holds for what it does not count.
            return await within(asked, 3.0 * self._opcua.request_s)
        except BrokenOff:
            raise LinkLost(f"{url}: the connection broke while {what} was under way") from None
        except TimeoutError:
            raise LinkLost(f"{url}: no answer in time to {what}") from None
        except EbamcheckError:
            raise
        except Exception as error:
            raise _ours(error, url, what, connecting) from None


class _Told:
    """Takes the notifications of a subscription: something has changed, and all is read at once then."""

    def __init__(self, changed: asyncio.Event) -> None:
        self._changed = changed

    def datachange_notification(self, *_: Any) -> None:
        self._changed.set()

    status_change_notification = datachange_notification


def _ours(error: Exception, url: str, what: str, connecting: bool) -> EbamcheckError:
    from asyncua.ua.uaerrors import UaError, UaStatusCodeError

    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, UaStatusCodeError):
        name = type(error).__name__
        if name.startswith(FULL):
            return LinkLost(f"{url}: the control has no session left ({name})")
        if connecting and name.startswith(LOGIN):
            return LoginRefused(f"{url}: {name}: check opcua.user, the password and the certificates")
        if name.startswith(GONE):
            return LinkLost(f"{url}: {what} failed ({name})")
        refused = "refused", "{what} is refused ({name})"
        code, reason = next((told for names, told in REFUSALS.items() if name in names), refused)
        return NotTaken(code, reason.format(what=what, name=name))
    if isinstance(error, UaError) and connecting:
        return LoginRefused(f"{url}: {text}")
    if isinstance(error, FileNotFoundError):
        return InputError(f"{error.filename}: cannot be read")
    if isinstance(error, OSError | UaError | EOFError):
        return LinkLost(f"{url}: {what}: {text}")
    # Whatever else the library comes to, the server stays and tries again.
    return LinkLost(f"{url}: {what}: {type(error).__name__}: {text}")
