"""Report writers: the house's write into the run folder, a stranger's into a copy (``python -m ebamcheck.pipeline.reports NAME
VALUE FOLDER PARENT``)."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path

from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.installed import distribution_of, is_house
from ebamcheck.plugins import registry
from ebamcheck.plugins.processes import die_with, one_line, run_limited
from ebamcheck.record.run_folder import FINGERPRINT, MANIFEST, TIMINGS, RunFolder
from ebamcheck.record.signing import SIGNATURES

TIME_S = 600.0  # time of one report writer of another distribution
MEMORY_MB = 8192.0  # its resident memory
LARGEST_REPORT_BYTES = 1_000_000_000
MOST_FILES = 10_000  # what is taken of one writer: more is no report
RESERVED = (MANIFEST, FINGERPRINT, SIGNATURES, "certificate.json")  # the harness's own
DONE = "done"  # file beside the copy that says that the writer has come back
OF_RECORD = "OF_RECORD"  # name of the tuple in which a package of ours tells which of its report writers read the record of a run alone
Note = Callable[[str], None]


def write_reports(folder: Path, note: Note) -> None:
    """Let every installed report writer render a run; one that is lost is a note, not the end, and the run stays whole."""
    for left_out in registry.left_out(registry.REPORTS):
        note(str(left_out))
    for name, point in registry.points(registry.REPORTS).items():
        try:
            if is_house(point):
                registry.load(point)(RunFolder(folder))
            else:
                _write_apart(point, folder, note)
        except Exception as error:
            why = str(error) if isinstance(error, SettingsError) else f"{type(error).__name__}: {error}"
            note(f"report writer {name!r} failed: {why}")


def _write_apart(point: EntryPoint, folder: Path, note: Note) -> None:
    """Run a stranger's writer on a copy of the run, in a process of its own, and take its new files over."""
    whose = f"report writer {point.name!r} of {' '.join(distribution_of(point)).strip() or 'another distribution'}"
    with tempfile.TemporaryDirectory(prefix="ebamcheck-", ignore_cleanup_errors=True) as temporary:
        copy = Path(temporary) / "run"
        shutil.copytree(folder, copy, symlinks=True)
        arguments = ["ebamcheck.pipeline.reports", point.name, point.value, str(copy)]
        lost = run_limited(arguments, Path(temporary), TIME_S, MEMORY_MB)
        if lost or not (Path(temporary) / DONE).is_file():
            note(f"{whose} was lost: {lost or 'it ended the process with code 0'}")
            return
        for refused in _take(copy, folder):
            note(f"{whose}: {refused}")


def _take(copy: Path, folder: Path) -> Iterator[str]:
    """Take the new files of a copy into the run folder; what is not taken, in words."""
    made = []
    for parent, _, names in os.walk(copy):
        made += [Path(parent, name) for name in names]
    if not (copy / MANIFEST).is_file():
        yield "it removed files of its copy of the run; the run has them still"
    fresh = []
    for file in sorted(made):
        name = file.relative_to(copy)
        if file.is_symlink() or not file.is_file():
            yield f"{name} is no plain file: it was not taken"
        elif (folder / name).exists():
            if _changed(file, folder / name):
                yield f"it changed {name}, which is not its own: the run's was kept"
        elif name.parts[0] in RESERVED:
            yield f"{name} is a name of the run's own: it was not taken"
        else:
            fresh.append((file, folder / name))
    if len(fresh) > MOST_FILES or sum(file.stat().st_size for file, _ in fresh) > LARGEST_REPORT_BYTES:
        yield f"it wrote over {MOST_FILES} files or {LARGEST_REPORT_BYTES // 10**6} MB: nothing was taken"
        return
    for file, target in fresh:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)


def _changed(file: Path, original: Path) -> bool:
    """Whether a copied file was written to since; a copy keeps size and time."""
    now, then = file.stat(), original.stat()
    return (now.st_size, now.st_mtime_ns) != (then.st_size, then.st_mtime_ns)


def reports_again(run: RunFolder) -> dict[str, bytes]:
    """Files that the house's writers of such reports make of the record of a run alone, by name; an InputError where one cannot be
    made from it."""
    found: dict[str, bytes] = {}
    for name, point in registry.points(registry.REPORTS).items():
        package = import_module(point.module.partition(".")[0]) if is_house(point) else None
        if name not in getattr(package, OF_RECORD, ()):
            continue
        with tempfile.TemporaryDirectory(prefix="ebamcheck-", ignore_cleanup_errors=True) as temporary:
            bare = RunFolder(Path(temporary))
            for file in (MANIFEST, TIMINGS):
                if (run.path / file).is_file():
                    shutil.copyfile(run.path / file, bare.path / file)
            try:
                written = registry.load(point)(bare)
            except EbamcheckError:
                raise
            except Exception as error:  # A record that was tampered with may hold anything.
                why = f"{type(error).__name__}: {error}"
                raise InputError(f"{run.path / MANIFEST}: report {name!r} cannot be made from it: {why}") from None
            found |= {file: (bare.path / file).read_bytes() for file in written}
    return found


def main(arguments: Sequence[str]) -> int:
    """Run one writer: what to load, and the folder, a copy of the run, into which it writes."""
    name, value, folder, parent = arguments
    die_with(int(parent))
    try:
        EntryPoint(name, value, "ebamcheck.reports").load()(RunFolder(Path(folder)))
    except Exception as error:
        sys.stderr.write(f"{type(error).__name__}: {one_line(str(error))}\n")
        return 1
    # A writer that ends the process with code 0 does not come here.
    (Path(folder).parent / DONE).touch()
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stderr.flush()
    os._exit(code)
