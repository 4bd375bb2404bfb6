"""Values as strict JSON, always written the same way, and the hashes that follow."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.atomic_file import replacing


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of_json(value: Any) -> str:
    """SHA-256 of a value as compact JSON with sorted keys, as settings are hashed."""
    text = json.dumps(plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def plain(value: Any) -> Any:
    """Turn a value into what strict JSON can hold: numpy numbers and arrays, tuples, infinities (as text)."""
    if isinstance(value, Mapping):
        return {plain(str(k)): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, np.ndarray):
        return [plain(v) for v in value.tolist()]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
    if isinstance(value, str | Path):
        # A file name need not be UTF-8; what cannot be written as such is escaped.
        return str(value).encode("utf-8", "backslashreplace").decode("utf-8")
    return value


def json_text(value: Any) -> str:
    """Strict JSON with sorted keys, as files hold it."""
    return json.dumps(plain(value), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(value: Any, path: Path) -> None:
    """Write strict JSON with sorted keys, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(json_text(value), encoding="utf-8")
