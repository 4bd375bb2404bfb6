"""What comes from outside: files that are none, JSON that two readers take in two ways, text that a terminal obeys."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import write_stl
from parts import box

from ebamcheck.atomic_file import regular_file
from ebamcheck.commands.command_group import ended_by
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.json_values import MOST_DIGITS, MOST_NESTED, parsed_json, read_json
from ebamcheck.layers.files import read_layers
from ebamcheck.printable import PrintableStream, printable
from ebamcheck.program import read_program
from ebamcheck.settings.config import load_config

# -- files that are none -------------------------------------------------------------------------------


def bound_socket(path):
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(str(path))


KINDS = {
    "pipe": os.mkfifo, "folder": os.mkdir, "socket": bound_socket, "device": lambda path: path.symlink_to("/dev/zero"),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("a.toml", load_config),
        ("a.parquet", read_layers),
        ("a.cli", read_layers),
        ("A.SPF", lambda path: read_program(path, None)),
        ("run.json", read_json),
        ("x", regular_file),
    ],
)
def test_what_is_no_file_is_refused_by_every_reader_before_it_is_opened(tmp_path, monkeypatch, kind, name, read):
    """Each of these would hang, never end, or fill the memory, were it opened."""
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    KINDS[kind](path := Path(name))
    with pytest.raises((InputError, SettingsError), match=f"is a {kind}|holds 0 main programs"):
        read(path)


def test_a_link_to_a_file_is_a_file_and_a_loop_is_none(tmp_path):
    (tmp_path / "a").write_text("")
    (tmp_path / "link").symlink_to("a")
    (tmp_path / "loop").symlink_to("loop")
    assert regular_file(tmp_path / "link") == tmp_path / "link"
    for name in ("loop", "gone"):  # whoever opens it says what is wrong with it
        with pytest.raises(SettingsError, match=f"{name}: cannot be read"):
            load_config(tmp_path / name)
    with pytest.raises(SettingsError, match="cannot be read: embedded null"):
        regular_file("a\0b", SettingsError)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"[layers]\nlayer_height_mm = 1{'0' * 5000}", "is not TOML"),
        (f"a = {'[' * 900}{']' * 900}", "lists within each other|is not TOML"),
        ("[layers]\nlayer_height_mm = 1\nlayer_height_mm = 2", "Cannot overwrite"),
    ],
)
def test_settings_of_thousands_of_digits_or_lists_are_refused_in_one_line(tmp_path, text, said):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(SettingsError, match=said):
        load_config(tmp_path / "a.toml")


# -- strict JSON ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"a": 1, "b": {"c": 2, "c": 3}}', "the key 'c' stands twice"),
        ("9" * 5000, "a number of 5000 digits"),
        ("9" * (MOST_DIGITS + 1), "a number of 21 digits"),
        ("1e999", "beyond the range"),
        ("NaN", "no number of JSON"),
        ("-Infinity", "no number of JSON"),
        ("[" * 900 + "]" * 900, "lists and tables within each other"),
        ("[" * 100_000, "lists and tables within each other"),
        ("[" * (MOST_NESTED + 1) + "]" * (MOST_NESTED + 1), "lists and tables within each other"),
        ('{"a": 1', "Expecting"),
        ("", "Expecting"),
    ],
)
def test_json_that_two_readers_could_take_in_two_ways_is_refused(text, said):
    with pytest.raises(ValueError, match=said):
        parsed_json(text)


def test_json_within_the_limits_is_read():
    assert parsed_json("9" * MOST_DIGITS) == int("9" * MOST_DIGITS)
    assert parsed_json('{"a": [1, 2.5, {"a": 1}], "b": {"a": null}}') == {
        "a": [1, 2.5, {"a": 1}],
        "b": {"a": None},
    }
    nested = parsed_json("[" * MOST_NESTED + "]" * MOST_NESTED)
    assert str(nested) == "[" * MOST_NESTED + "]" * MOST_NESTED


# -- printable text ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Jürgen Ångström 東", "Jürgen Ångström 東"),
        ("\x1b[2K\x1b[1APASS", r"\x1b[2K\x1b[1APASS"),
        ("a\nb\tc\rd", r"a\nb\tc\rd"),
        ("\x9b2J", r"\x9b2J"),
        ("\u202egnp.exe", r"\u202egnp.exe"),
        ("\u2028", r"\u2028"),
        ("\udcff", r"\udcff"),
        (7, "7"),
    ],
)
def test_text_that_a_terminal_would_obey_is_shown_as_escapes(text, shown):
    assert printable(text) == shown


def test_a_stream_keeps_its_lines_and_nothing_else_that_a_terminal_obeys():
    stream = PrintableStream(into := io.StringIO())
    print("a\tb\nc\x1b[2J", file=stream)
    assert into.getvalue() == "a\tb\nc\\x1b[2J\n"
    assert stream.isatty() is False


# -- how a command ends --------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [("--help",), ("config",)])
def test_a_full_disk_has_a_line_and_a_code_of_its_own_and_a_reader_that_has_gone_none(tmp_path, arguments):
    told = shell(tmp_path, arguments, "> /dev/full")
    assert told.returncode == ExitCode.DISK_FULL
    assert "No space left on device" in told.stderr
    assert told.stderr.count("\n") == 1
    told = shell(tmp_path, arguments, "| true; exit ${PIPESTATUS[0]}")
    assert told.returncode in (ExitCode.PASS, ExitCode.NOBODY_READS)
    assert told.stderr == ""


def test_a_stream_that_is_closed_takes_nothing_from_a_command(tmp_path):
    write_stl(box(), tmp_path / "box.stl")
    told = shell(tmp_path, ("slice", "box.stl", "--layer-height", "2", "-o", "a.parquet"), "<&- >&- 2>&-")
    assert told.returncode == ExitCode.PASS
    assert len(read_layers(tmp_path / "a.parquet"))


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (MemoryError(), ExitCode.MEMORY_FULL),
        (RuntimeError("can't start new thread"), ExitCode.MEMORY_FULL),
        (RuntimeError("anything else"), ExitCode.INTERNAL),
        (OSError(12, "Cannot allocate memory"), ExitCode.MEMORY_FULL),
        (OSError(28, "No space left on device", "a.csv"), ExitCode.DISK_FULL),
        (OSError(122, "Disk quota exceeded"), ExitCode.DISK_FULL),
        (OSError(13, "Permission denied", "a.csv"), ExitCode.USAGE),
        (InputError("a.stl: is none"), ExitCode.USAGE),
    ],
)
def test_what_the_system_lacks_is_no_internal_error(capfd, error, code):
    assert ended_by(error) is code
    assert capfd.readouterr().err.count("\n") == 1


def test_what_is_behind_an_error_tells_its_code():
    behind = SettingsError("a.csv: cannot be written")
    behind.__context__ = OSError(28, "No space left on device")
    assert ended_by(behind) is ExitCode.DISK_FULL


def shell(place, arguments, rest):
    """Run the program by a shell, which redirects its streams."""
    code = "import sys; from ebamcheck.commands.main import main; main()"
    line = f'"$0" -c "$1" "${{@:2}}" {rest}'
    return subprocess.run(
        ["bash", "-c", line, sys.executable, code, *arguments], cwd=place, capture_output=True, text=True, check=False
    )  # fmt: skip
