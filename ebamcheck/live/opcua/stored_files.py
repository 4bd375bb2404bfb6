"""Files of a played control, in a folder, as a control keeps them: a build of thousands of layers has hundreds of megabytes."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from pathlib import Path
from urllib.parse import quote, unquote


class StoredFiles(MutableMapping[str, bytes]):
    """Contents by place; each in a file that is named by its place.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = StoredFiles(Path(folder))
    ...     files["//NC/MAIN.SPF"] = b"M17"
    ...     sorted(path.name for path in Path(folder).iterdir()), dict(files)
    (['%2F%2FNC%2FMAIN.SPF'], {'//NC/MAIN.SPF': b'M17'})
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def _at(self, place: str) -> Path:
        return self._folder / quote(place, safe=" _-")

    def __getitem__(self, place: str) -> bytes:
        """Return a file."""
        try:
            return self._at(place).read_bytes()
        except FileNotFoundError:
            raise KeyError(place) from None

    def __setitem__(self, place: str, content: bytes) -> None:
        """Keep a file."""
        self._at(place).write_bytes(content)

    def __delitem__(self, place: str) -> None:
        """Delete a file."""
        try:
            self._at(place).unlink()
        except FileNotFoundError:
            raise KeyError(place) from None

    def __iter__(self) -> Iterator[str]:
        """Go through all places."""
        return (unquote(path.name) for path in self._folder.iterdir())

    def __len__(self) -> int:
        """Return how many files there are."""
        return sum(1 for _ in self._folder.iterdir())
