"""NC programs: written by a post-processor, read back by an independent reader, and verified."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebamcheck.names_on_demand import on_demand

if TYPE_CHECKING:
    from ebamcheck.checks.consumables import program_summary as program_summary
    from ebamcheck.nc.files import ProgramFiles as ProgramFiles
    from ebamcheck.nc.files import mark_validated as mark_validated
    from ebamcheck.nc.motions import NCProgram as NCProgram
    from ebamcheck.nc.reader import read_program as read_program
    from ebamcheck.program.verification import verify_file as verify_file
    from ebamcheck.program.verification import verify_program as verify_program
    from ebamcheck.result import Check as Check
    from ebamcheck.writing.posts import write_program as write_program

# Names and where they live; they load when first used: who asks what a control is waits for no planning and no check.
_HOMES = {
    "Check": "result",
    "NCProgram": "nc.motions",
    "ProgramFiles": "nc.files",
    "mark_validated": "nc.files",
    "program_summary": "checks.consumables",
    "read_program": "nc.reader",
    "verify_file": "program.verification",
    "verify_program": "program.verification",
    "write_program": "writing.posts",
}
__all__ = [*_HOMES]
__getattr__ = on_demand("ebamcheck", _HOMES)
