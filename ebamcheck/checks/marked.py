"""Marking a program as validated, and seeing that nothing but its status has changed.

The checks read the program before it is marked. What is marked is what runs on the machine, and nobody reads it again: so it
is held against the bytes that were checked.
"""

from __future__ import annotations

from ebamcheck.nc.files import STATUS_LINES, ProgramFiles, mark_validated

NOT = b"NOT "
"""What a file loses when it is marked."""

VALIDATED = b"VALIDATED"
"""What follows it."""


def marked_validated(files: ProgramFiles) -> ProgramFiles:
    """Mark a program that was checked as validated.

    Raises
    ------
    RuntimeError
        If more has changed than its status: a mistake of this program. Its files are then again those that were checked.
    """
    checked = {name: (files.folder / name).read_bytes() for name in files.names}
    made = mark_validated(files)
    for name, data in checked.items():
        if made.folder != files.folder or not is_marked(data, (made.folder / name).read_bytes()):
            for file, before in checked.items():
                (files.folder / file).write_bytes(before)
            raise RuntimeError(f"{made.folder / name}: more than its status has changed since it was checked")
    return made


def is_marked(checked: bytes, marked: bytes) -> bool:
    """Whether bytes are those that were checked, with the status of a program that is validated in one of its first lines.

    Examples
    --------
    >>> is_marked(b"%_N_A_MPF\\n; NOT VALIDATED\\nM30\\n", b"%_N_A_MPF\\n; VALIDATED\\nM30\\n")
    True
    >>> is_marked(b"%_N_A_MPF\\n; NOT VALIDATED\\nM30\\n", b"%_N_A_MPF\\n; VALIDATED\\nM3\\n")
    False
    """
    at = next((i for i, (a, b) in enumerate(zip(checked, marked, strict=False)) if a != b), len(marked))
    if checked[at : at + len(NOT)] != NOT or not checked.startswith(VALIDATED, at + len(NOT)):
        return False
    return marked == checked[:at] + checked[at + len(NOT) :] and checked[:at].count(b"\n") < STATUS_LINES
