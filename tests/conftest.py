"""Fixtures of the whole suite."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# A run of the suite repeats the one before it; `--hypothesis-profile=search` looks for new examples.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search")
settings.load_profile("repeatable")

# Files that take longest, in quick or slow tests
LONGEST_FIRST = (
    "test_live_server.py", "test_live_opcua.py", "test_conformance.py", "test_witnesses.py", "test_laws.py",
    "test_documentation.py", "test_interrupted_runs.py", "test_bounds.py", "test_benchmarks.py", "test_slabs.py",
    "test_honest_programs.py", "test_faults.py", "test_live_opcua_access.py", "test_kernels.py", "test_models.py",
    "test_surface_curves.py", "test_machine_state.py", "test_cli.py", "test_enemies.py", "test_isolation.py",
    "test_pipeline.py", "test_regression.py", "test_scan_command.py", "test_interpass.py",
    "test_hatch.py", "test_lattice.py", "test_preheated_layers.py", "test_surface.py",
    "test_oracle.py", "test_controls.py", "test_scan.py",
    "test_whole_part.py", "test_curve_evidence.py", "test_program_faults.py",
    "test_chance_curves.py", "test_text_attacks.py", "test_entry_program.py", "test_signing.py", "test_live.py",
)  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    """Have the workers take files in the order given here; their own is that of the number of tests."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # A shell starts so what it runs in the background; processes that tests interrupt would inherit it.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False
    if hasattr(config, "workerinput"):  # the process that drives them collects nothing
        gc.disable()


def pytest_collection_finish() -> None:
    """Spare the garbage collector what was collected: thousands of tests, which stay to the end."""
    gc.enable()
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first: the workers then end at about the same time."""
    take_turns(items)
    places = {name: place for place, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: places.get(item.path.name, len(places)))


def take_turns(items: Iterable[pytest.Item]) -> None:
    """Make slow tests of all cases that are marked `in_turn` but every n-th: they are alike, and `.ci/run` runs all of them."""
    seen: Counter[str] = Counter()
    for item in items:
        if (mark := item.get_closest_marker("in_turn")) is None:
            continue
        test = item.nodeid.partition("[")[0]
        every, first = (*mark.args, 0)[:2]
        if seen[test] % every != first:
            item.add_marker("slow")
        seen[test] += 1


@pytest.fixture(scope="session")
def corpus() -> Path:
    """Folder of the mesh corpus; tests that need it skip where there is none."""
    folder = os.environ.get("EBAMCHECK_CORPUS", "")
    if not folder:
        pytest.skip("EBAMCHECK_CORPUS names no folder: the mesh corpus is not part of the project")
    return Path(folder)


@pytest.fixture(scope="module")
def place(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the STL file and the finished run of the box whose SIZE the test module names."""
    from live_boxes import run_of_box

    return run_of_box(tmp_path_factory, request.module.SIZE)


@pytest.fixture(scope="module")
def maker(place: Path) -> Iterator[object]:
    """Maker of the layers of that box."""
    from live_boxes import maker_of

    with maker_of(place) as made:
        yield made
