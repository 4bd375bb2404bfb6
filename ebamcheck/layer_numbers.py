"""Numbers of layers: whoever reads or types one counts from 1, as the program's files do; indices in Python count from 0."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebamcheck.errors import SettingsError

if TYPE_CHECKING:
    import pandas as pd


def numbered(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table as a person opens it: its column `layer`, an index, counts from 1; one without layers stays as it is.

    >>> import pandas as pd
    >>> numbered(pd.DataFrame({"layer": [0, 1]}))["layer"].tolist()
    [1, 2]
    """
    return table.assign(layer=table["layer"] + 1) if "layer" in table else table


def indexed(table: pd.DataFrame) -> pd.DataFrame:
    """Take back :func:`numbered`, for a table that was read: its column `layer` is an index from 0."""
    return table.assign(layer=table["layer"] - 1) if "layer" in table else table


def index_of_number(number: int, layers: int, option: str = "--layer") -> int:
    """Index of the layer that an option names by its number.

    >>> index_of_number(12, 12)
    11
    """
    if not 1 <= number <= layers:
        why = "layers are counted from 1, as in the names of the program's files: " if number == 0 else ""
        raise SettingsError(f"{option} {number}: {why}the run has the layers 1 to {layers}")
    return number - 1
