"""Reproduce: everything needed to make the same run again."""

from __future__ import annotations

import json

from ebamcheck.settings.checking import as_toml
from ebamcheck_reports.markup import Markup, collapsed, element, facts, paragraph, section
from ebamcheck_reports.run_data import RunData


def render(run: RunData) -> Markup:
    """Command line, settings, versions and hashes."""
    part = run.part_of("part")
    command = f"ebamcheck run {_quoted(part['source'])} --config ebamcheck.toml"
    reference = run.part_of("reference")
    if reference:
        command += f" --reference {_quoted(_base_name(reference['part']['source']))}"
    return section(
        "reproduce",
        "Reproduce",
        "The same part, settings and versions give the same files, byte for byte; when the run was made and how long each stage took stands in timings.json. Good is a run whose hashes match these.",
        paragraph("Save the settings below as ", element("code", "ebamcheck.toml"), " and run"),
        element("pre", command),
        facts(
            [
                ("ebamcheck", run.manifest["ebamcheck"]),
                ("Python", run.manifest["python"]),
                ("SHA-256 of the part's file", element("code", part["sha256"])),
                ("SHA-256 of the mesh as placed", element("code", part["mesh_sha256"])),
                ("SHA-256 of the settings", element("code", run.manifest["settings_sha256"])),
            ]
        ),
        collapsed("Settings as ebamcheck.toml", element("pre", as_toml(run.config))),
        collapsed(
            "Settings as run.json holds them",
            element("pre", json.dumps(run.manifest["settings"], indent=2, sort_keys=True)),
        ),
    )


def _base_name(path: str) -> str:
    return path.replace("\\", "/").rsplit("/", 1)[-1]


def _quoted(name: str) -> str:
    import shlex

    return shlex.quote(name)
