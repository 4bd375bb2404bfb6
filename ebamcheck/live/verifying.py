"""A build checked after the fact: its journal, the files that it published, and each layer from its text, part and settings alone.

Heat and metal are followed from the plate up; above a layer whose heat or surface was measured, or that a scan preheats, nothing is
said."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.consumables import FRESH, Spent, lasting
from ebamcheck.checks.heat_again import BeadHeat, FollowedHeat, highest_entry_k, may_differ_k
from ebamcheck.checks.interpass_checks import sections_of_text, text_beads, within_range
from ebamcheck.checks.mesh_checks import layer_check
from ebamcheck.errors import EbamcheckError, InputError
from ebamcheck.json_values import json_text, sha256_of_file, sha256_of_json
from ebamcheck.layers.heights import cut_heights
from ebamcheck.live import publishing
from ebamcheck.live.before import Before, metal_checks
from ebamcheck.live.publishing import CERTIFICATE, CURRENT, JOURNAL, LAYERS, PROGRAM, SETTINGS, ended_early
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import read_part
from ebamcheck.nc.roles import by_height, by_shape
from ebamcheck.pipeline.cross_check import witness_backend
from ebamcheck.program.verification import read_checked
from ebamcheck.record.certificate_checks import part_hash
from ebamcheck.settings.config import Config, load_config
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.verification.verify import verify

VERIFIED = "verified.json"  # what was found, in the folder of the build


@dataclass(frozen=True)
class Due:
    """What the journal asks of a layer."""

    layer: int  # its index, from 0
    base_mm: float  # height that was measured below it
    wait_s: float | None  # between the last bead below it and its first one; None: by an earlier version


@dataclass(frozen=True)
class VerifiedLayer:
    """One published layer: its name, checks made, and what is wrong, in words; empty where nothing is."""

    name: str
    checks: int
    why: str
    files: dict[str, str]

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.why


def is_build(folder: Path) -> bool:
    """Whether a folder is that of a build."""
    return (folder / JOURNAL).is_file()


def holds_layers(folder: Path) -> bool:
    """Whether a folder is that of a build, or holds layers that `ebamcheck relayer` made, each by itself."""
    return is_build(folder) or any((folder / LAYERS).glob(f"*/{CERTIFICATE}"))


def verify_build(
    folder: Path, part: Path, told: Callable[[VerifiedLayer], None] = lambda layer: None
) -> list[VerifiedLayer]:
    """Verify every published layer of a build, and write down what was found; a damaged journal or part raises
    :class:`InputError`."""
    if not part.is_file():
        raise InputError(f"{part}: cannot be read: there is no such file")
    found, spent, build = [], FRESH, is_build(folder)
    heat, metal, known = FollowedLayers(), FollowedMetal(part), build
    layers = [*_published(folder)]
    for number, (name, files, due) in enumerate(layers, 1):
        layer, spent = _verified(folder, name, files, due, part, spent if due else FRESH)
        # What is wrong by itself tells nothing of the layers above.
        known = known and layer.passed
        if known:
            place = folder / LAYERS / name
            files_of_it = place / PROGRAM, publishing.read_certificate(place), load_config(place / SETTINGS)
            warm = heat.too_warm(*files_of_it)
            heat.take()
            layer = replace(layer, why="; ".join(filter(None, (metal.wrong_with(*files_of_it), warm))))
        if build and layer.passed and number == len(layers):
            layer = replace(layer, why=_not_current(folder, name) or _ended_early(folder, name, part))
        found.append(layer)
        told(layer)
    publishing.write_synced(folder / VERIFIED, json_text([asdict(layer) for layer in found]))
    return found


def _published(folder: Path) -> Iterator[tuple[str, dict[str, str], Due | None]]:
    """Name and hashes of the published layers, in order, and what the journal asks of each; where there is no build, by the
    certificates."""
    if not is_build(folder):
        for path in sorted((folder / LAYERS).glob(f"*/{CERTIFICATE}")):
            try:
                files = json.loads(path.read_text(encoding="utf-8"))["files"]
                yield path.parent.name, {str(name): str(sha256) for name, sha256 in files.items()}, None
            except (ValueError, TypeError, KeyError, AttributeError):
                raise InputError(f"{path}: is no certificate of a layer") from None
        return
    layer, base_mm = 0, math.nan
    for entry in publishing.read_journal(folder / JOURNAL):
        if entry.get("kind") == "height":
            # A height of another layer is none that this one was laid on.
            base_mm = float(entry["height_mm"]) if entry.get("done") == layer else math.nan
        elif entry.get("kind") == "layer":
            yield str(entry["name"]), dict(entry["files"]), Due(layer, base_mm, entry.get("wait_s"))
            layer, base_mm = layer + 1, math.nan


def _verified(
    folder: Path, name: str, files: dict[str, str], due: Due | None, part: Path, spent: Spent
) -> tuple[VerifiedLayer, Spent]:
    """One layer, and what is taken of spool and cathode when it is done; `spent` is that before it."""
    told_by, place = "the journal" if due else f"its {CERTIFICATE}", folder / LAYERS / name
    for file, sha256 in files.items():
        path = place / PROGRAM / file
        if not path.is_file() or sha256_of_file(path) != sha256:
            return VerifiedLayer(name, 0, f"{path}: is not the file that {told_by} names", files), spent
    try:
        config = load_config(place / SETTINGS)
        if why := _other_than(publishing.read_certificate(place), name, files, due, config, part):
            return VerifiedLayer(name, 0, why, files), spent
        checks = verify(place / PROGRAM, part, config)
        # Of the lowest layer the settings alone do not ask that it is cut where it comes to lie.
        placed, heights = read_part(part, config.part)[0], config.layers.heights_mm
        cut_mm = heights[0] if len(heights) == 1 else math.nan
        checks.append(layer_check(placed, cut_mm, config.base_mm, config.layer_height_mm))
    except EbamcheckError as error:
        return VerifiedLayer(name, 0, str(error), files), spent
    wrong = [check.in_words() for check in checks if not check.passed]
    if len(checks) < 40 and not wrong:  # a program that was read at all has more
        wrong = [f"{len(checks)} checks alone could be made"]
    lasts, spent = lasting(checks, config, spent)
    wrong += [check.in_words() for check in lasts if not check.passed]
    return VerifiedLayer(name, len(checks), "; ".join(wrong), files), spent


def _other_than(
    paper: dict[str, Any], name: str, files: dict[str, str], due: Due | None, config: Config, part: Path
) -> str:
    """What certificate, settings, journal and part do not have in common: by others than those published, checks prove nothing."""
    wanted: tuple[tuple[str, object, object], ...] = (
        ("name", paper.get("name"), name),
        *((("number of the layer", paper["layer"], due.layer + 1),) if due else ()),
        *((("wait before it", paper.get("wait_s"), due.wait_s),) if due and due.wait_s is not None else ()),
        ("files", paper.get("files"), files),
        ("validated", paper.get("validated"), True),
        ("hash of the settings", paper.get("settings_sha256"), sha256_of_json(config.model_dump())),
        ("hash of the part", paper["part"]["sha256"], part_hash(part)),
    )
    for what, said, is_so in wanted:
        if said != is_so:
            return f"{CERTIFICATE}: {what}: {said!s:.60}, in place of {is_so!s:.60}"
    heights = [("its settings", config.base_mm), *([("the journal", due.base_mm)] if due else [])]
    for where, base_mm in heights:
        if not abs(paper["base_mm"] - base_mm) <= 1e-6:
            return f"{CERTIFICATE}: lies on {paper['base_mm']:.6g} mm, by {where} on {base_mm:.6g} mm"
    return ""


def _not_current(folder: Path, name: str) -> str:
    """Why the layer that is to be called next is not the one that was published last, by certificate and file; empty where it
    is."""
    try:
        current = publishing.read_current(folder) or {}
    except ValueError:
        return f"{CURRENT}: cannot be read"
    place, paper = folder / LAYERS / name, publishing.read_certificate(folder / LAYERS / name)
    wrong = publishing.current_off(place / PROGRAM, folder / str(current.get("program")), current, paper)
    if wrong or current != publishing.current_of(paper):
        return f"{CURRENT}: is not that of {name}, the layer that was published last: {', '.join(wrong) or 'values'}"
    return ""


def _ended_early(folder: Path, name: str, file: Path) -> str:
    """Why a build that is said to be done is not; empty where it is, or goes on."""
    ends = [entry for entry in publishing.read_journal(folder / JOURNAL) if entry.get("kind") == "done"]
    if not ends:
        return ""
    config = load_config(folder / LAYERS / name / SETTINGS)
    why = ended_early(float(read_part(file, config.part)[0].size[2]), float(ends[-1]["height_mm"]), config)
    return f"{JOURNAL}: {why}" if why else ""


def read_verified(folder: Path) -> dict[str, VerifiedLayer]:
    """What was found before, by name, of layers whose files are still those; nothing where nobody has verified."""
    path = folder / VERIFIED
    if not path.exists():
        return {}
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return {str(row["name"]): VerifiedLayer(**row) for row in rows}
    except (ValueError, TypeError, KeyError):
        raise InputError(f"{path}: is not what `ebamcheck verify` writes") from None


def layer_text(program: Path, paper: Mapping[str, Any], config: Config) -> tuple[BeadHeat, BaseGeometry] | None:
    """Heat and section of one layer, whose certificate tells the wait before it; None where its text does not say how warm it makes
    the part.

    A text that cannot be read says nothing, and one that preheats has its temperatures judged where it is made.
    """
    wait_s = paper.get("wait_s")
    if not isinstance(wait_s, int | float) or "temperature" in paper:
        return None
    text, _ = read_checked(program, config)
    if text is None:
        return None
    text = by_shape(by_height(text, np.array([config.base_mm + config.layer_height_mm])))
    beads = text_beads(text, config)
    if beads.scans or not len(beads):
        return None
    off_s, heat_j = beads.move_s + beads.wait_s, beads.energy_j * config.material.absorptivity
    off_s[0] += wait_s
    heat = BeadHeat(np.zeros(off_s.size, np.int64), off_s, beads.time_s, heat_j)
    return heat, sections_of_text(text, config, None)[0]


class FollowedLayers:
    """Heat of a build, layer by layer: one is judged on those that were taken before it."""

    def __init__(self) -> None:
        self._heat: FollowedHeat | None = None
        self._after: FollowedHeat | None = None
        self._known = True

    def too_warm(self, program: Path, paper: Mapping[str, Any], config: Config) -> str:
        """Why a bead is entered above the limit, with what two balances may differ by on top; empty where none is."""
        text = layer_text(program, paper, config) if self._known else None
        self._after = None
        if text is None:
            return ""
        below = self._heat or FollowedHeat(config)
        bed_k, self._after = below.with_layer(*text, config.layer_height_mm)
        entered_k = float(bed_k[0] if config.process.interpass_at == "layer" else bed_k.max())
        most_k = highest_entry_k(config) + may_differ_k(config)
        if entered_k <= most_k:
            return ""
        said_k, mark = within_range(entered_k, config)
        return f"heat over all layers: a bead of it is entered at {said_k:.0f} K{mark} by the texts so far; the limit is {most_k:.0f} K"

    def take(self) -> None:
        """Let the layer that was judged last be the uppermost."""
        self._heat, self._after, self._known = self._after, None, self._after is not None


class FollowedMetal:
    """Metal of a build, from the plate up."""

    def __init__(self, part: Path) -> None:
        self._file, self._known = part, True
        self._placed: Part | None = None
        self._before: Before | None = None

    def wrong_with(self, program: Path, paper: Mapping[str, Any], config: Config) -> str:
        """Lay one more layer; what is wrong with it, empty where nothing is."""
        known, self._known = self._known, False  # what lies above this cannot be told, unless this is laid
        text, _ = read_checked(program, config) if known else (None, None)
        if text is None or "height_map" in paper:
            return ""
        part = self._placed = self._placed or read_part(self._file, config.part)[0]
        try:
            section = slice_part(part, cut_heights(part, config), witness_backend(str(paper["primary"])))
            told = paper["metal_so_far"]
        except (EbamcheckError, KeyError, TypeError, ValueError):
            return ""
        self._known = True
        before = self._before or Before.plate(part, config)
        text = by_height(text, np.array([config.base_mm + config.layer_height_mm]))
        checks, self._before = metal_checks(text, section, before.measured(), config)
        assert self._before.below is not None
        wrong = [f"metal over all layers: {check.in_words()}" for check in checks if not check.passed]
        if not _same(told, asdict(self._before.below)):
            wrong.append("metal over all layers: its certificate has other sums of it than the texts so far")
        return "; ".join(wrong)


def _same(told: Any, worked_out: dict[str, Any]) -> bool:
    """Whether sums over layers, as a certificate has them, are those worked out: far nearer than with a layer less, less so by
    another slicer."""
    try:
        pairs = ((np.asarray(told[name], np.float64), value) for name, value in worked_out.items())
        return all(np.allclose(said, np.asarray(found), rtol=1e-3, atol=1e-3) for said, found in pairs)
    except (KeyError, TypeError, ValueError):
        return False
