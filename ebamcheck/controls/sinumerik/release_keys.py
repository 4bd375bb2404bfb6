"""Keys by which a waiting main program tells a release from a value that somebody else wrote.

The key of the layer below is worked out from that of a layer, and not the other way round. A seal over key, layer, number and wait
belongs to each release. All is whole numbers below 2^53, exact in a REAL of the control. It is no cryptography: who works it out
can undo it."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

PRIME = 33_554_393  # Modulus of keys and seals, the greatest prime below 2^25: squares stay exact
LAYERS = 10_000  # Layers that have a key: the numbers of four digits, and the end of the build after them
SET_OFF = 20_000  # Added to the number of a program, so that no seal is worked out from the key below


@dataclass(frozen=True)
class Release:
    """Values that release a layer, from 1, or say that the part is built (-1)."""

    released: float
    number: float
    wait_s: float
    key: float
    seal: float


class ReleaseKeys:
    """Keys of a build, worked out from the one drawn for its last layer.

    >>> keys = ReleaseKeys(12345)
    >>> keys.of(7) == key_below(keys.of(8), 8)
    True
    """

    def __init__(self, drawn: int) -> None:
        keys = [drawn]
        for layer in range(LAYERS, 1, -1):
            keys.append(key_below(keys[-1], layer))
        self._keys = keys[::-1]

    def of(self, layer: int) -> int:
        """Key of a layer, from 1."""
        return self._keys[layer - 1]

    def release(self, layer: int, number: int, wait_s: float) -> Release:
        """Release a layer."""
        key = self.of(layer)
        return Release(layer, number, wait_s, key, seal(key, number, wait_s, layer))

    def built(self, layers: int) -> Release:
        """Say that the part is built, after so many layers."""
        key = self.of(layers + 1)
        return Release(-1.0, 0.0, 0.0, key, seal(key, 0, 0.0, -1))


def drawn_key() -> int:
    """Draw the key of a build's last layer."""
    return 2 + secrets.randbelow(PRIME - 2)


def key_below(key: int, layer: int) -> int:
    """Key of the layer below one, of that layer's key."""
    return (key * key + layer) % PRIME


def seal(key: int, number: int, wait_s: float, released: int) -> int:
    """Seal of a release."""
    found = (key * key + SET_OFF + number) % PRIME
    found = (found * found + int(1000.0 * wait_s + 0.5)) % PRIME
    return (found * found + released + 1) % PRIME
