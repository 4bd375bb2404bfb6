"""NC programs: written by a post-processor, read back by an independent reader, and verified."""

from ebamcheck.program.checks import Check as Check
from ebamcheck.program.files import ProgramFiles as ProgramFiles
from ebamcheck.program.files import mark_validated as mark_validated
from ebamcheck.program.motions import NCProgram as NCProgram
from ebamcheck.program.posts import write_program as write_program
from ebamcheck.program.reader import read_program as read_program
from ebamcheck.program.summary import program_summary as program_summary
from ebamcheck.program.verification import verify_file as verify_file
from ebamcheck.program.verification import verify_program as verify_program

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
