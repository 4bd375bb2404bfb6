"""The certificate of a run: what was made from what, by what, how well, and who releases it; made last, beside the record.

Its seal tells whether it is whole, its list of files whether the run is, signatures who stands for it. :func:`ebamcheck.verify`
believes none of it."""

from __future__ import annotations

import functools
import hashlib
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import ebamcheck.version
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import json_text, plain, read_json, sha256_of_file, sha256_of_json, write_json
from ebamcheck.record.form import CERTIFICATE_FORMAT, PLATE, CertificateForm, in_form
from ebamcheck.record.run_folder import MANIFEST, RunFolder, own_file
from ebamcheck.record.signing import SIGNATURES, signature_files
from ebamcheck.result import SEVERITIES
from ebamcheck.settings.config import Config, validated

CERTIFICATE = "certificate.json"
PROFILE = ("machine", "process", "material", "kinematics")  # sections of machine and process

# What a person adds when the run is released (`ebamcheck sign`), and its empty values. The seal covers it
RELEASE: Mapping[str, Any] = {
    "part_number": "",
    "revision": "",
    "machine_serial": "",
    "lots": {},
    "operator": "",
    "approver": "",
    "date": "",
    "deviations": [],
}

OF_PART = ("name", "source", "sha256", "mesh_sha256", "units", "direction")
PLACED = ("place_at_mm", "rotate_deg")  # what a record says of its part only where the settings place it

# What no gate of a run is about
NOT_PROVED = (
    "that the mesh is the part that was drawn: it is compared with nothing but itself",
    "what the codes of the machine maker do on the machine",
    "how wire, melt pool and vacuum behave: metal and heat are models with nominal data",
    "distortion, residual stress, porosity, microstructure",
    "that the machine's calibration, axes and wire feed are what its profile says",
)


def certificate(manifest: Mapping[str, Any], made: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """What the record of a run says of it, as its certificate holds it, without files, release and seal; `made` is the software
    that made it."""
    config = validated(manifest["settings"], "run.json: settings")
    program = manifest.get("program") or {"files": [], "validated": False, "checks": []}
    part, machine = manifest["part"], config.machine
    fields = {
        "format": CERTIFICATE_FORMAT,
        "finished": manifest["timings"]["finished"],
        "part": {key: part[key] for key in (*OF_PART, *PLACED) if key in part or key not in PLACED},
        "heights": manifest["heights"],
        "settings_sha256": manifest["settings_sha256"],
        "profile_sha256": profile_sha256(manifest["settings"]),
        "record_sha256": record_sha256(manifest),
        "programs": [{"name": f["name"], "sha256": f["sha256"]} for f in program["files"]],
        "primary": manifest["primary"],
        "witness": program.get("witness", ""),
        "software": software(manifest) if made is None else made,
        "control": machine.control,
        "curve_form": machine.curve_form,
        "spline_convention": _convention(config),
        "smoothing": {"words": list(machine.smoothing), "tolerance_mm": machine.smoothing_tolerance_mm},
        "gates": manifest["gates"],
        "checks": program.get("checks", []),
        "validated": bool(program["validated"]),
        "not_proved": NOT_PROVED,
    }
    if PLATE in manifest:
        fields[PLATE] = manifest[PLATE]
    if "findings" in manifest:  # a run of an earlier version has none
        said = statement(manifest)
        fields |= {"findings": manifest["findings"], "proved": said.proved, "left_to_do": said.left}
    return dict(plain(fields))


def write_certificate(run: RunFolder, release: Mapping[str, Any] | None = None) -> Path:
    """Write the certificate of a run beside its record, with what `release` says; every other file of the run must be there and
    final."""
    said = {"release": {**RELEASE, **(release or {})}, "files": file_hashes(run.path)}
    return write_sealed(run.path / CERTIFICATE, {**certificate(run.manifest()), **said})


def released(path: Path, release: Mapping[str, Any]) -> Path:
    """Write what a person adds into a certificate, and seal it anew; a broken seal, or a signature that would no longer hold, is
    refused."""
    found = read_certificate(path)
    if not is_sealed(path, found):
        why = "it was changed since it was written, and is not to be signed"
        raise InputError(f"{path}: its seal is broken: {why}")
    after = {**found["release"], **release}
    if after == found["release"]:
        return path
    if signature_files(path):
        raise SettingsError(
            f"{path}: is signed, and a change would break the signature: remove {path.parent / SIGNATURES} to sign it anew"
        )
    return write_sealed(path, {**found, "release": after})


def write_sealed(path: Path, fields: Mapping[str, Any]) -> Path:
    """Write fields with the seal that belongs to them."""
    kept = {key: value for key, value in fields.items() if key != "seal"}
    write_json({**kept, "seal": seal(kept)}, path)
    return path


def seal(fields: Mapping[str, Any]) -> str:
    """SHA-256 of all fields but the seal itself."""
    return sha256_of_json({key: value for key, value in fields.items() if key != "seal"})


def is_sealed(path: Path, found: Mapping[str, Any]) -> bool:
    """Whether a certificate's seal fits, and its bytes are those that were written with it."""
    return found.get("seal") == seal(found) and path.read_bytes() == json_text(found).encode()


def file_hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a run folder but the certificate and its signatures, by relative name."""
    return {name: sha256_of_file(folder / name) for name in file_names(folder)}


def file_names(folder: Path) -> list[str]:
    """Relative names of the files that a certificate lists: of all that stands there and is no folder."""
    found = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    names = (path.relative_to(folder).as_posix() for path in found)
    own = CERTIFICATE, "fingerprint"
    return sorted(n for n in names if n not in own and not n.startswith(f"{SIGNATURES}/"))


def profile_sha256(settings: Mapping[str, Any]) -> str:
    """SHA-256 of the machine profile: the sections of machine, process, material and kinematics, as they were recorded."""
    return sha256_of_json({name: settings[name] for name in PROFILE})


def record_sha256(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of a run's record without its timings."""
    return sha256_of_json({k: v for k, v in manifest.items() if k != "timings"})


def find_certificate(program: Path) -> Path | None:
    """Certificate beside a program's folder, or in it; raises :class:`InputError` where no file has its name."""
    return _beside(program, CERTIFICATE)


def find_record(program: Path) -> Path | None:
    """Record of the run (``run.json``) that a program belongs to; raises :class:`InputError` where no file has its name."""
    return _beside(program, MANIFEST)


def _beside(program: Path, name: str) -> Path | None:
    folder = program if program.is_dir() else program.parent
    return next((place / name for place in (folder, folder.parent) if own_file(place / name)), None)


def read_certificate(path: Path) -> dict[str, Any]:
    """Read a certificate; raises :class:`InputError` where it is none, or has not the form of one."""
    found = read_json(path)
    if not isinstance(found, dict) or found.get("format") != CERTIFICATE_FORMAT:
        raise InputError(f"{path}: is not a certificate of format {CERTIFICATE_FORMAT}")
    return in_form(CertificateForm, found, path)


def lots_of(assignments: Sequence[str]) -> dict[str, str]:
    """Lots given as NAME=NUMBER, such as ``wire=W-1234``; raises :class:`SettingsError` for another form."""
    lots = {}
    for text in assignments:
        name, equals, number = text.partition("=")
        if not (equals and name.strip() and number.strip()):
            raise SettingsError(f"--lot {text!r}: write it as NAME=NUMBER, such as wire=W-1234")
        lots[name.strip()] = number.strip()
    return lots


def _convention(config: Config) -> str:
    shift = config.machine.bspline_shift
    if shift == "uniform":
        return "PL: even intervals"
    return f"PL of block i carries U[i+{shift}] - U[i+{shift - 1}]"


# What each gate proves where it has passed, and what is not proved where it is shut; of another one its own text says it
PROVED: Mapping[str, str] = {
    "input": "the part is a closed solid",
    "agreement": "independent slicers find the same contours on every layer",
    "fit": "the curves stay near the contours",
    "coverage": "the beads leave nothing of the sections bare",
    "deposit": "the metal laid is that of the sections within its tolerances, by a model of the melt pool",
    "heat": "no bead is entered above the limit, by the heat model",
    "program": "the program's path, read back from its text, is that of the part, within the limits of machine and process",
    "entry": "the program that begins at a layer is the end of the whole one, and starts safely by itself",
}

DRY_RUN = "a dry run on the control, with beam and wire off"
CODES_OF_THE_MAKER = "the machine maker's codes in place of the default ones for beam and wire"
APPROVAL = "approval: name, date and signature on the certificate"


@dataclass(frozen=True)
class Statement:
    """What shut gates leave unproved, what is proved, and what is left to a person, in short clauses."""

    unproved: tuple[str, ...]
    proved: tuple[str, ...]
    left: tuple[str, ...]

    def lines(self) -> list[str]:
        """All in words, a line each."""
        return [f"{head}: {'; '.join(said)}" for head, said in self.parts() if said]

    def parts(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """All with their heads, what matters most first."""
        return ("Not proved", self.unproved), ("Proved", self.proved), ("Left to you", self.left)


def statement(manifest: Mapping[str, Any]) -> Statement:
    """Statement of a run from its record; what comes after a validated program (codes, dry run, approval) is said of no other
    one."""
    gates, found = manifest["gates"], manifest.get("findings", [])
    said = [(gate["passed"], PROVED.get(gate["name"], gate["text"])) for gate in gates]
    unproved, proved = (tuple(text for passed, text in said if passed is which) for which in (False, True))
    shut = [str(gate["name"]) for gate in gates if not gate["passed"]]
    left = [f"to open the gate{'s' if len(shut) > 1 else ''} {', '.join(shut)}"] if shut else []
    grave = [finding for finding in found if finding["severity"] != "note"]
    left += [f"a look at {counted(grave)}"] if grave else []
    if manifest.get("program") and manifest["exit_code"] == 0:
        codes = any(finding["code"] == "placeholder-codes" for finding in found)
        left += [*([CODES_OF_THE_MAKER] if codes else []), _consumables(manifest), DRY_RUN, APPROVAL]
    return Statement(unproved, proved, tuple(text for text in left if text))


def _consumables(manifest: Mapping[str, Any]) -> str:
    """What the build uses up, of which the profile does not say how much there is: no check knows whether it lasts."""
    machine, totals = manifest["settings"]["machine"], manifest["program"]["totals"]
    said = {
        "spool_kg": f"{totals['wire_kg']:.3g} kg of wire on the spool",
        "cathode_h": f"a cathode for {totals['deposit_s'] / 3600.0:.3g} h of beam",
    }
    return " and ".join(text for name, text in said.items() if machine.get(name) is None)


def counted(findings: list[Mapping[str, Any]]) -> str:
    """Count findings by severity, the gravest first.

    >>> counted([{"severity": "note"}, {"severity": "warning"}, {"severity": "note"}])
    '1 warning, 2 notes'
    """
    counts = {s: sum(finding["severity"] == s for finding in findings) for s in SEVERITIES}
    return ", ".join(f"{n} {name}{'' if n == 1 else 's'}" for name, n in counts.items() if n)


# -- what a run was made with ----------------------------------------------------------------------

GIT_TIMEOUT_S = 10.0  # a checkout that git cannot look through in this time has an unknown state
UNKNOWN = "unknown"
_NAME = re.compile(r"[A-Za-z0-9._-]+")


def software(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Identity of everything that took part in a run whose record is `manifest`: version, commit and hash of the source,
    interpreter, system, every distribution that is required, directly or not, and device and versions that each backend told."""
    return {
        "ebamcheck": manifest["ebamcheck"],
        "source": source_state(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.platform()}, {' '.join(platform.libc_ver())}".rstrip(", "),
        "dependencies": dict(dependencies()),
        "backends": {
            name: {"device": found["device"], "versions": found["versions"]}
            for name, found in manifest["backends"].items()
        },
    }


@functools.cache
def source_state() -> dict[str, str]:
    """Commit of the checkout that this package is run from (none: it is installed), whether it differs from it, and the hash of its
    files."""
    root = Path(ebamcheck.__file__).resolve().parent.parent
    return {"commit": commit(), "dirty": _dirty(root), "sha256": source_sha256()}


@functools.cache
def source_sha256() -> str:
    """SHA-256 over names and contents of the package's Python files, in the order of their names."""
    folder = Path(ebamcheck.__file__).resolve().parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        data = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(data)}\0".encode())
        digest.update(data)
    return digest.hexdigest()


def commit() -> str:
    """Commit of the checkout that this package is run from; empty for an installed one."""
    return (_git(Path(ebamcheck.__file__).resolve().parent.parent, "rev-parse", "HEAD") or "").strip()


@functools.cache
def dependencies() -> Mapping[str, str]:
    """Version of every distribution that ebamcheck requires, and that these require in turn, by name."""
    found: dict[str, str] = {}
    waiting = ["ebamcheck"]
    while waiting:
        name = waiting.pop()
        try:
            distribution = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue
        key = distribution.metadata["Name"].lower().replace("_", "-")
        if key in found:
            continue
        found[key] = distribution.version
        needed = (_NAME.match(line) for line in distribution.requires or () if "extra ==" not in line)
        waiting += [name[0] for name in needed if name]
    found.pop("ebamcheck", None)
    return dict(sorted(found.items()))


def _dirty(root: Path) -> str:
    """Whether files under version control differ from the commit, or there are new ones among the sources."""
    found = _git(root, "status", "--porcelain", "--", "ebamcheck", "backends", "reports", "pyproject.toml")
    return UNKNOWN if found is None else "yes" if found.strip() else "no"


def _git(root: Path, *arguments: str) -> str | None:
    git = shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    try:
        done = subprocess.run(
            [git, "-C", str(root), *arguments],
            capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout
