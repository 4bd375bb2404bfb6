"""Certificates and keys of a connection, read and held against each other before anything is opened."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from ebamcheck.errors import SettingsError
from ebamcheck.settings.opcua import OpcuaSettings

if TYPE_CHECKING:
    from cryptography import x509


def content_of(opcua: OpcuaSettings, key: str) -> tuple[bytes, str]:
    """Content of a certificate or key, which is one, and its form."""
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization

    path = Path(str(getattr(opcua, key)))
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SettingsError(f"opcua.{key} {str(path)!r}: cannot be read: {error.strerror}") from None
    pem = b"-----BEGIN" in content
    try:
        if key == "private_key":
            (serialization.load_pem_private_key if pem else serialization.load_der_private_key)(content, None)
        else:
            (x509.load_pem_x509_certificate if pem else x509.load_der_x509_certificate)(content)
    except (ValueError, TypeError):
        what = "key without a password" if key == "private_key" else "certificate"
        raise SettingsError(f"opcua.{key} {str(path)!r}: is no {what} in PEM or DER") from None
    return content, "pem" if pem else "der"


def _certificate(opcua: OpcuaSettings, key: str) -> x509.Certificate:
    from cryptography import x509

    content, form = content_of(opcua, key)
    return (x509.load_pem_x509_certificate if form == "pem" else x509.load_der_x509_certificate)(content)


def check_pair(opcua: OpcuaSettings) -> None:
    """Refuse a key of another certificate, one that has run out, or one of another `application_uri`.

    Raises
    ------
    SettingsError
        With the setting and its file.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization

    content, form = content_of(opcua, "private_key")
    load = serialization.load_pem_private_key if form == "pem" else serialization.load_der_private_key
    key, own = load(content, None), _certificate(opcua, "certificate")
    if key.public_key() != own.public_key():
        raise SettingsError(
            f"opcua.private_key {opcua.private_key!r}: is not the key of opcua.certificate {opcua.certificate!r}: give the two of one pair"
        )
    try:
        names = own.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    except x509.ExtensionNotFound:
        uris = []
    if opcua.application_uri not in uris:
        raise SettingsError(
            f"opcua.certificate {opcua.certificate!r}: is for {', '.join(uris) or 'no URI'}, opcua.application_uri is "
            f"{opcua.application_uri!r}: a control refuses what is not alike"
        )
    now = datetime.datetime.now(datetime.UTC)
    for setting in ("certificate", "server_certificate"):
        found, file = _certificate(opcua, setting), getattr(opcua, setting)
        first, last = found.not_valid_before_utc, found.not_valid_after_utc
        if not first <= now <= last:
            raise SettingsError(
                f"opcua.{setting} {file!r}: holds from {first:%Y-%m-%d} to {last:%Y-%m-%d}, today is {now:%Y-%m-%d}"
            )


def is_offered(opcua: OpcuaSettings, shown: Iterable[bytes]) -> bool:
    """Whether the certificate that was given for the control is among those that it shows, in DER."""
    from cryptography.hazmat.primitives.serialization import Encoding

    # What is shown may be a chain, with the certificate itself first.
    given = _certificate(opcua, "server_certificate").public_bytes(Encoding.DER)
    return any(found.startswith(given) for found in shown)
