"""Signatures under a certificate: Ed25519 (RFC 8032), detached, one file a signer, who alone can make it with the private key.

Keys are PEM files, as `openssl genpkey -algorithm ed25519` writes them, too: the private one in PKCS 8, the public one as
SubjectPublicKeyInfo."""

from __future__ import annotations

import base64
import binascii
import getpass
import hashlib
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import read_json, write_json
from ebamcheck.printable import printable
from ebamcheck.result import Check

SIGNATURES = "signatures"  # folder of the signatures, beside the certificate
SIGNATURE_SUFFIX = ".json"
SIGNATURE_FORMAT = 1
PURPOSE = b"ebamcheck certificate signature 1\0"  # begins every signed message
PRIVATE_SUFFIX, PUBLIC_SUFFIX = ".key", ".pub"
FINGERPRINT_DIGITS = 16
SIGNED = ("certificate_sha256", "name", "role", "date")  # what a signature covers
VALID, TRUSTED, BROKEN = "signed", "trusted", "broken"


@dataclass(frozen=True)
class Signature:
    """One signature, as it was found."""

    file: str
    state: str  # `TRUSTED` (valid, by a key that is trusted), `VALID` (by another key) or `BROKEN`
    name: str
    fingerprint: str
    text: str  # in words: who signed, with which key, or why it does not hold


# -- keys --------------------------------------------------------------------------------------------


def make_key(path: str | Path, password: str = "") -> tuple[Path, Path]:
    """Make ``PATH.key`` (mode 600) and ``PATH.pub``, in a folder (mode 700) that is made; a file that is there is refused: a key
    overwritten is lost."""
    stem = Path(path)
    private_path, public_path = (stem.with_name(stem.name + end) for end in (PRIVATE_SUFFIX, PUBLIC_SUFFIX))
    for file in (private_path, public_path):
        if file.exists():
            raise SettingsError(f"{file}: is there already, and a key that is overwritten is lost: give another name")
    key, pem = Ed25519PrivateKey.generate(), serialization.Encoding.PEM
    encryption: serialization.KeySerializationEncryption = serialization.NoEncryption()
    if password:
        encryption = serialization.BestAvailableEncryption(password.encode())
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, encryption)
    public = key.public_key().public_bytes(pem, serialization.PublicFormat.SubjectPublicKeyInfo)
    try:
        stem.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor = os.open(private_path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file_:
            file_.write(private)
        public_path.write_bytes(public)
    except OSError as error:
        raise SettingsError(f"{stem}: the keys cannot be written: {error.strerror or error}") from error
    return private_path, public_path


def read_private_key(path: Path, password: str = "") -> Ed25519PrivateKey:
    """Read a private key; raises :class:`InputError` for what is none, or for a wrong password."""
    data = _bytes_of(path)
    try:
        key = serialization.load_pem_private_key(data, password.encode() if password else None)
    except TypeError:
        asked = "is protected: give its password" if not password else "is not protected: give no password"
        raise InputError(f"{path}: the key {asked}") from None
    except (ValueError, UnsupportedAlgorithm):
        raise InputError(f"{path}: is no private key in PEM, or the password is wrong") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{path}: is a key of another kind than Ed25519: make one with `ebamcheck key`")
    return key


def read_public_key(path: Path) -> Ed25519PublicKey:
    """Read a public key; raises :class:`InputError` for what is none."""
    try:
        key = serialization.load_pem_public_key(_bytes_of(path))
    except (ValueError, UnsupportedAlgorithm):
        raise InputError(f"{path}: is no public key in PEM") from None
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{path}: is a key of another kind than Ed25519")
    return key


def trusted_keys(places: Sequence[str | Path]) -> dict[bytes, str]:
    """Public keys of files, and of all ``*.pub`` of folders: raw bytes, and the name of the file; raises InputError for what is
    none."""
    found: dict[bytes, str] = {}
    for place in map(Path, places):
        files = sorted(place.glob(f"*{PUBLIC_SUFFIX}")) if place.is_dir() else [place]
        if not files:
            raise InputError(f"{place}: holds no public key (*{PUBLIC_SUFFIX})")
        found |= {_raw(read_public_key(file)): file.stem for file in files}
    return found


def fingerprint(public: bytes) -> str:
    """First digits of the SHA-256 of a public key's 32 bytes, by which people tell keys apart."""
    return hashlib.sha256(public).hexdigest()[:FINGERPRINT_DIGITS]


def asked_password(path: Path) -> str:
    """Password of a protected key, asked for on the terminal; empty for a key without one."""
    return getpass.getpass(f"password of {path}: ") if b"ENCRYPTED" in _bytes_of(path) else ""


# -- signing -----------------------------------------------------------------------------------------


def sign(certificate: Path, key: Ed25519PrivateKey, name: str, role: str = "approver", date: str = "") -> Path:
    """Sign a certificate's bytes; returns the file of the signature, which takes the place of one by the same key."""
    public = _raw(key.public_key())
    said = {
        "certificate_sha256": hashlib.sha256(_bytes_of(certificate)).hexdigest(),
        "name": name,
        "role": role,
        "date": date or time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    folder = certificate.parent / SIGNATURES
    folder.mkdir(exist_ok=True)
    path = folder / f"{fingerprint(public)}{SIGNATURE_SUFFIX}"
    bytes_of = {"public_key": public, "signature": key.sign(_message(said))}
    coded = {name: base64.b64encode(data).decode() for name, data in bytes_of.items()}
    write_json({"format": SIGNATURE_FORMAT, **said, **coded}, path)
    return path


def signatures(certificate: Path, trusted: dict[bytes, str]) -> list[Signature]:
    """Every signature that lies beside a certificate, judged; in the order of their files."""
    digest = hashlib.sha256(_bytes_of(certificate)).hexdigest()
    return [_judged(path, digest, trusted) for path in signature_files(certificate)]


def signature_files(certificate: Path) -> list[Path]:
    """Files of the signatures beside a certificate, in order; what else lies in their folder is none."""
    return sorted((certificate.parent / SIGNATURES).glob(f"*{SIGNATURE_SUFFIX}"))


def signature_check(certificate: Path, trusted: dict[bytes, str] | None) -> Check:
    """Check the signatures: none may be broken, and where keys are trusted, one of them must have signed."""
    found = signatures(certificate, trusted or {})
    where = f"{SIGNATURES}/{found[0].file}" if found else certificate.name
    broken = [s for s in found if s.state == BROKEN]
    if broken:
        text = broken[0].text + (f" (and {len(broken) - 1} more)" if len(broken) > 1 else "")
        where = f"{SIGNATURES}/{broken[0].file}"
        return Check("signature", False, float(len(broken)), 0.0, "faults", where, text)
    text = "; ".join(s.text for s in found) or "unsigned: anyone who can write here can write another one"
    others = sorted({*(certificate.parent / SIGNATURES).glob("*")} - {*signature_files(certificate)})
    text += f"; ignored: {', '.join(printable(path.name) for path in others)}" if others else ""
    if trusted is not None and not any(s.state == TRUSTED for s in found):
        return Check.fault("signature", where, f"no trusted key has signed: {text}")
    return Check("signature", True, 0.0, 0.0, "faults", where, text)


def _judged(path: Path, digest: str, trusted: dict[bytes, str]) -> Signature:
    try:
        found = read_json(path)
        public = base64.b64decode(found["public_key"], validate=True)
        signature = base64.b64decode(found["signature"], validate=True)
        said = {field: found[field] for field in SIGNED}
        if not all(isinstance(value, str) for value in said.values()):
            raise ValueError
        keys = {"format", *SIGNED, "public_key", "signature"}
        if found["format"] != SIGNATURE_FORMAT or set(found) != keys:
            raise ValueError
        Ed25519PublicKey.from_public_bytes(public).verify(signature, _message(said))
    except (InputError, ValueError, KeyError, TypeError, binascii.Error):
        return Signature(path.name, BROKEN, "", "", "is no signature of ours")
    except InvalidSignature:
        text = "the signature does not fit what it covers"
        return Signature(path.name, BROKEN, "", fingerprint(public), text)
    key = fingerprint(public)
    name, role, date = (printable(said[field]) for field in ("name", "role", "date"))
    if said["certificate_sha256"] != digest:
        what = "another certificate than this one: it was changed since, or comes from elsewhere"
        return Signature(path.name, BROKEN, name, key, f"{name} signed {what}")
    by = f"{name} ({role}) on {date} with key {key}"
    if public in trusted:
        return Signature(path.name, TRUSTED, name, key, f"signed by {by}, trusted as {trusted[public]}")
    return Signature(path.name, VALID, name, key, f"signed by {by}, whose key is not among trusted ones")


def _message(said: dict[str, Any]) -> bytes:
    return PURPOSE + json.dumps(said, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def _raw(key: Ed25519PublicKey) -> bytes:
    return key.public_bytes(serialization.Encoding.Raw, serialization.PublicFormat.Raw)


def _bytes_of(path: Path) -> bytes:
    try:
        return regular_file(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
