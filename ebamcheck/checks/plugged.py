"""Checks of a program that strangers add: entry points of the group ``ebamcheck.checks``.

Each is a function of the program as read back and the settings, and returns the :class:`Check` that it made, or several. It
sees what every check of the house sees, and shuts the same gate.
"""

from __future__ import annotations

from dataclasses import replace

from ebamcheck.checks.checks import Check
from ebamcheck.nc.motions import NCProgram
from ebamcheck.plugins import registry
from ebamcheck.settings.config import Config


def plugged_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Make the checks of all plugins, by name; one that raises or returns no check is a failed check of its name."""
    return [check for name in registry.names(registry.CHECKS) for check in _made(name, nc, config)]


def _made(name: str, nc: NCProgram, config: Config) -> list[Check]:
    try:
        found = registry.plugin(registry.CHECKS, name)(nc, config)
        checks = [found] if isinstance(found, Check) else list(found)
        if not all(isinstance(check, Check) for check in checks):
            raise TypeError("it returned what is no Check")
    except Exception as error:
        text = f"plugin {name!r} of {registry.CHECKS}: {type(error).__name__}: {error}"
        remedy = "tell those who make the plugin, or remove it"
        return [Check(name, False, 1.0, 0.0, "", nc.files[0].name, text, remedy=remedy)]
    return [check if check.text else replace(check, text=_figures(check)) for check in checks]


def _figures(check: Check) -> str:
    """What a check found that says nothing itself."""
    return f"{check.value:.6g} {check.unit}, the limit is {check.limit:.6g}"
