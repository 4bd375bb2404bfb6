"""A finished run as Python sees it: its verdict, gates and findings, and what it made, each read when it is first asked for."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

from ebamcheck.curves import Curves
from ebamcheck.errors import ExitCode, InputError
from ebamcheck.layers.stack import Layers
from ebamcheck.pipeline.job import Observer
from ebamcheck.pipeline.run import check_job, run_job
from ebamcheck.program import NCProgram, read_program
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.result import Check, check_of_record, finding_of_record, gate_of_record
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config, load_config, validated
from ebamcheck.settings.stages import for_this_machine
from ebamcheck.showing import short_text


class Run:
    """A finished run folder.

    Parameters
    ----------
    path
        The folder.

    Raises
    ------
    InputError
        If it is no finished run; from every property, too, whose file is missing or damaged.

    Examples
    --------
    >>> Run("nowhere")
    Traceback (most recent call last):
    ebamcheck.errors.InputError: nowhere: is no run folder: it has no run.json

    :func:`run` makes one.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.record: dict[str, Any] = RunFolder(self.path).manifest()
        """``run.json``, of which everything else is a rendering."""

    @property
    def is_check(self) -> bool:
        """Whether it was a cross-check alone, without a program."""
        return bool(self.record.get("job") == "check")

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of the command line."""
        return ExitCode(int(self.record["exit_code"]))

    @property
    def passed(self) -> bool:
        """Whether every gate passed."""
        made = self.is_check or bool((self.record.get("program") or {}).get("validated"))
        return made and self.exit_code is ExitCode.PASS

    @property
    def verdict(self) -> str:
        """``VALIDATED`` or ``NOT VALIDATED``; of a cross-check ``AGREED`` or ``NOT AGREED``."""
        word = "AGREED" if self.is_check else "VALIDATED"
        return word if self.passed else f"NOT {word}"

    @cached_property
    def gates(self) -> tuple[Check, ...]:
        """Gates in the order in which the run came to them."""
        return tuple(gate_of_record(gate) for gate in self.record["gates"])

    @cached_property
    def findings(self) -> tuple[Check, ...]:
        """What a person has to know beside the gates, the gravest first."""
        return tuple(finding_of_record(found) for found in self.record.get("findings", []))

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """Checks of the program; none where there is none."""
        return tuple(check_of_record(check) for check in (self.record.get("program") or {}).get("checks", []))

    @property
    def report(self) -> Path:
        """``report.html``."""
        return self._file("report.html")

    @cached_property
    def config(self) -> Config:
        """Settings of the run."""
        return validated(self.record["settings"], MANIFEST)

    @property
    def slicers(self) -> tuple[str, ...]:
        """Slicers that ran to their end."""
        return tuple(name for name, found in self.record["backends"].items() if found["status"] == "done")

    def layers_of(self, slicer: str) -> Layers:
        """Layers of one slicer."""
        if slicer not in self.slicers:
            known = ", ".join(self.slicers) or "none"
            raise InputError(f"{self.path}: has no layers of {slicer!r}: it has {known}")
        return RunFolder(self.path).read_layers(slicer)

    @cached_property
    def layers(self) -> Layers:
        """Layers that the program was made from."""
        return self.layers_of(str(self.record.get("primary", "")))

    @cached_property
    def curves(self) -> Curves:
        """Fitted contours."""
        return Curves.from_parquet(self._file("curves.parquet"))

    @cached_property
    def plan(self) -> ScanPlan:
        """Islands, their order and lines."""
        return ScanPlan.from_parquet(self._file("scan.parquet"))

    @cached_property
    def program(self) -> NCProgram:
        """The program, read back from its text."""
        files = (self.record.get("program") or {}).get("files", [])
        if not files:
            raise InputError(f"{self.path}: wrote no program: see its gates")
        return read_program(RunFolder(self.path).program_folder / files[0]["name"], self.config)

    def verify(self, part: str | Path | None = None, *, quick: bool = False) -> list[Check]:
        """Work every gate out again; see :func:`ebamcheck.verify`."""
        from ebamcheck.verification.verify import verify

        return verify(self.path, part, quick=quick)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the layers on three-dimensional matplotlib axes."""
        return self.layers.plot(ax, **style)

    def _file(self, name: str) -> Path:
        path = self.path / name
        if not path.is_file():
            why = "the run did not come so far, or the file was removed"
            raise InputError(f"{self.path}: has no {name}: {why}")
        return path

    def __repr__(self) -> str:
        shut = [gate.name for gate in self.gates if not gate.passed]
        gates = f"{len(self.gates) - len(shut)} of {len(self.gates)} gates passed"
        not_passed, findings = f"not {' and '.join(shut)}" if shut else "", len(self.findings)
        told = (self.verdict, gates, not_passed, short_text.counted(findings, "finding"), str(self.path))
        return short_text.line("Run", str(self.record["part"]["name"]), *told)

    def _repr_html_(self) -> str:
        """Show verdict, gates and findings in a notebook."""
        gates = {gate.name: f"{'pass' if gate.passed else 'FAIL'}: {gate.text}" for gate in self.gates}
        findings = {f"{found.severity} {n}": found.text for n, found in enumerate(self.findings, 1)}
        return short_text.html(f"{self.record['part']['name']}: {self.verdict}", {**gates, **findings})


def run(
    part: str | Path,
    target: str | Path | None = None,
    config: Config | str | Path | None = None,
    *,
    reference: str | Path | None = None,
    resume: bool = False,
    observer: Observer | None = None,
) -> Run:
    """Slice, cross-check, fit, partition, order, write the NC program, verify it and report, as ``ebamcheck run``.

    Parameters
    ----------
    part
        Mesh file of the part.
    target
        Run folder to make; None: NAME.run in the working folder.
    config
        Settings, or the file of them; None: the default ones.
    reference, resume, observer
        As of :func:`ebamcheck.pipeline.run_job`.

    Returns
    -------
    Run
        Also where a gate is shut: see ``verdict`` and ``gates``.

    Raises
    ------
    InputError, SettingsError, BackendMissing
        As of :func:`ebamcheck.pipeline.run_job`.

    Examples
    --------
    >>> import tempfile
    >>> import ebamcheck
    >>> from ebamcheck_models import CUBE
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = ebamcheck.save(CUBE.tessellate(0.1), Path(folder) / "cube.stl")
    ...     made = run(file, Path(folder) / "cube.run", Config(slicing={"backends": ("planecut", "manifold")}))
    ...     made.verdict, len(made.gates), len(made.layers)
    ('VALIDATED', 7, 12)
    """
    file, folder, chosen = _given(part, target, config)
    return Run(run_job(file, folder, chosen, reference, resume, observer).folder.path)


def check(
    part: str | Path,
    target: str | Path | None = None,
    config: Config | str | Path | None = None,
    *,
    resume: bool = False,
    observer: Observer | None = None,
) -> Run:
    """Slice with every backend and compare all pairs on every layer, as ``ebamcheck check``.

    Parameters
    ----------
    part, target, config, resume, observer
        As of :func:`run`.

    Returns
    -------
    Run
        Also where a gate is shut.

    Raises
    ------
    InputError, SettingsError, BackendMissing
        As of :func:`ebamcheck.pipeline.run_job`.

    Examples
    --------
    >>> import tempfile
    >>> import ebamcheck
    >>> from ebamcheck_models import CUBE
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = ebamcheck.save(CUBE.tessellate(0.1), Path(folder) / "cube.stl")
    ...     made = check(file, Path(folder) / "cube.run", Config(slicing={"backends": ("planecut", "manifold")}))
    ...     made.verdict, sorted(made.slicers)
    ('AGREED', ['manifold', 'planecut'])
    """
    file, folder, chosen = _given(part, target, config)
    return Run(check_job(file, folder, chosen, resume, observer).folder.path)


def _given(
    part: str | Path, target: str | Path | None, config: Config | str | Path | None
) -> tuple[Path, Path, Config]:
    """File, folder and settings as the command line would take them."""
    if not isinstance(part, str | Path):
        raise InputError(
            f"a run is of a part's file, whose hash stands in its certificate, not of a {type(part).__name__}: "
            "save it first: ebamcheck.save(part, 'part.stl')"
        )
    given = config if isinstance(config, Config) else load_config(config)
    return Path(part), Path(target or f"{Path(part).stem}.run"), for_this_machine(given)
