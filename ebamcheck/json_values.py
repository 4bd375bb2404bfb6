"""Values as strict JSON, always written the same way, and the hashes that follow."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.atomic_file import regular_file, replacing
from ebamcheck.errors import EbamcheckError, InputError

MOST_DIGITS = 20  # digits of a whole number in a file that is read: those of 64 bits
MOST_NESTED = (
    40  # lists and tables within each other in a file that is read; settings, records and certificates have ten
)


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal; raises :class:`InputError` for what is no regular file."""
    with regular_file(path).open("rb") as file:
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


def read_json(path: Path, error: type[EbamcheckError] = InputError) -> Any:
    """Read a JSON file strictly: what two readers could take in two ways is refused."""
    try:
        data = regular_file(path, error).read_bytes()
        return parsed_json(data)
    except OSError as found:
        raise error(f"{path}: cannot be read: {found.strerror or found}") from None
    except ValueError as found:
        raise error(f"{path}: cannot be read: {found}") from None


def parsed_json(data: bytes | str) -> Any:
    """Value of strict JSON; raises :class:`ValueError` for what :func:`read_json` refuses."""
    text = data.decode("utf-8") if isinstance(data, bytes) else data
    try:
        value = json.loads(
            text,
            object_pairs_hook=_without_twins,
            parse_int=_whole,
            parse_float=_finite,
            parse_constant=_no_constant,
        )
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    level = [value]
    for _ in range(MOST_NESTED + 1):
        held = [one for one in level if isinstance(one, dict | list)]
        level = [one for many in held for one in (many.values() if isinstance(many, dict) else many)]
    if held:
        raise ValueError(_TOO_DEEP)
    return value


_TOO_DEEP = f"more than {MOST_NESTED} lists and tables within each other"


def _without_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        twin = next(key for k, (key, _) in enumerate(pairs) if key in dict(pairs[:k]))
        raise ValueError(f"the key {twin[:40]!r} stands twice in one table")
    return found


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"the number {digits[:40]} is beyond the range of numbers")
    return value


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def json_text(value: Any) -> str:
    """Strict JSON with sorted keys, as files hold it."""
    return json.dumps(plain(value), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(value: Any, path: Path) -> None:
    """Write strict JSON with sorted keys, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(json_text(value), encoding="utf-8")
