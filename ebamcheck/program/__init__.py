"""NC programs: written by a post-processor, read back by an independent reader, and verified."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebamcheck.names_on_demand import on_demand

if TYPE_CHECKING:
    from ebamcheck.program.checking.checks import Check as Check
    from ebamcheck.program.checking.summary import program_summary as program_summary
    from ebamcheck.program.checking.verification import verify_file as verify_file
    from ebamcheck.program.checking.verification import verify_program as verify_program
    from ebamcheck.program.language.files import ProgramFiles as ProgramFiles
    from ebamcheck.program.language.files import mark_validated as mark_validated
    from ebamcheck.program.reading.motions import NCProgram as NCProgram
    from ebamcheck.program.reading.reader import read_program as read_program
    from ebamcheck.program.writing.posts import write_program as write_program

__all__ = [
    "Check",
    "NCProgram",
    "ProgramFiles",
    "mark_validated",
    "program_summary",
    "read_program",
    "verify_file",
    "verify_program",
    "write_program",
]

_HOMES = {
    "Check": "checking.checks",
    "NCProgram": "reading.motions",
    "ProgramFiles": "language.files",
    "mark_validated": "language.files",
    "program_summary": "checking.summary",
    "read_program": "reading.reader",
    "verify_file": "checking.verification",
    "verify_program": "checking.verification",
    "write_program": "writing.posts",
}
"""Names and where they live; they load when first used: who asks what a control is waits for no planning and no check."""

__getattr__ = on_demand(__name__, _HOMES)
