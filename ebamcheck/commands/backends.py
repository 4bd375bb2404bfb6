"""``ebamcheck backends``: the slicers that are installed, and what keeps others out."""

from __future__ import annotations

import warnings

from ebamcheck.commands.options import (
    JsonOption,
    print_json,
)
from ebamcheck.errors import ExitCode


def backends(as_json: JsonOption = False) -> ExitCode:
    """List the slicers: availability, versions, device, rules and error bound; and what is wrong with a plugin."""
    from ebamcheck.commands.summaries import backend_record, backends_text, broken_record
    from ebamcheck.plugins import registry

    with warnings.catch_warnings():
        # What is wrong with a plugin stands in the list.
        warnings.simplefilter("ignore", registry.BrokenPluginWarning)
        registry.forget(kept=True)
        records = [backend_record(name) for name in registry.slicers()]
        left_out = registry.broken_plugins()
    if as_json:
        print_json([*records, *(broken_record(plugin) for plugin in left_out)])
        return ExitCode.PASS
    print(backends_text(records, left_out))
    return ExitCode.PASS
