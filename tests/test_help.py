"""Every command says what it does by an example that fits its options; the shell completes names."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys

import pytest
import typer

from ebamcheck.commands.main import app

EXAMPLE = re.compile(r"Examples?: ((?:.|\n)*?)(?:\n\n|\Z)")

GROUP = typer.main.get_command(app)


def commands(group, context, path=()):
    """All commands and sub-commands by their path, each with its context."""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None, name
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        if hasattr(command, "list_commands"):
            yield from commands(command, inner, (*path, name))
        yield (*path, name), command, inner


ALL = {
    path: (command, inner)
    for path, command, inner in commands(GROUP, GROUP.make_context("ebamcheck", [], resilient_parsing=True))
}


def test_the_walk_meets_every_command():
    assert {"run", "slice", "config", "warm", "sign", "regress", "paper", "scan"} <= {path[0] for path in ALL}


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_every_command_has_an_example_that_it_takes(path):
    command, context = ALL[path]
    found = EXAMPLE.search(command.get_help(context))
    assert found, f"{' '.join(path)} --help shows no example"
    for example in " ".join(found[1].split()).split("; "):
        words = shlex.split(example)
        assert words[: len(path) + 1] == ["ebamcheck", *path]
        # Wrong options, missing arguments and words that are no number raise here.
        command.make_context(path[-1], words[len(path) + 1 :])


def complete(words, **environment):
    start = "from ebamcheck.commands.main import main; import sys; sys.argv[0] = 'ebamcheck'; main()"
    return subprocess.run(
        [sys.executable, "-c", start],
        env={**os.environ, "_EBAMCHECK_COMPLETE": "complete_bash", "COMP_WORDS": words,
             "COMP_CWORD": str(len(words.split(" ")) - 1), **environment},
        capture_output=True, text=True, check=False,
    ).stdout.split()  # fmt: skip


def test_the_shell_completes_commands_and_options():
    assert complete("ebamcheck sl") == ["slice"]
    assert complete("ebamcheck reg") == ["regress"]
    assert complete("ebamcheck run --fo") == ["--force"]


def test_completion_can_be_shown_and_installed(tmp_path):
    start = "from ebamcheck.commands.main import main; import sys; sys.argv[0] = 'ebamcheck'; main()"
    environment = {**os.environ, "HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    shown = subprocess.run(
        [sys.executable, "-c", start, "--show-completion", "bash"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "_EBAMCHECK_COMPLETE=complete_bash" in shown.stdout
    subprocess.run(
        [sys.executable, "-c", start, "--install-completion", "bash"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "ebamcheck" in (tmp_path / ".bashrc").read_text()
