"""NC programs: written by a post-processor, read back by an independent reader, and verified."""

from ebamcheck.program.checking.checks import Check as Check
from ebamcheck.program.checking.summary import program_summary as program_summary
from ebamcheck.program.checking.verification import verify_file as verify_file
from ebamcheck.program.checking.verification import verify_program as verify_program
from ebamcheck.program.files import ProgramFiles as ProgramFiles
from ebamcheck.program.files import mark_validated as mark_validated
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
