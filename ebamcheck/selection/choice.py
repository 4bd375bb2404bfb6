"""The choice of a machine's slicers by stated rules, with the reason for each that is not chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ebamcheck.selection.trial import Trial

TIE_SHARE = 0.1
"""Times that differ by less than this share of the shorter are a tie: runs differ by as much from each other."""

RULES = (
    "A slicer must be available and slice the part without a fault; its bound and its measured error must meet the "
    "tolerance; of those left the fastest is primary. Times within 10 % are a tie, which goes by priority, then by "
    "name. The next one is required, too: agreement takes two."
)


@dataclass(frozen=True)
class Choice:
    """What was chosen, and why."""

    primary: str
    """Empty where no slicer is fit."""
    witness: str
    """The slicer that the primary is held against; empty where none is left."""
    reasons: Mapping[str, str]

    @property
    def required(self) -> tuple[str, ...]:
        """Slicers that a run on this machine must have."""
        return tuple(name for name in (self.primary, self.witness) if name)


def choose(trials: Sequence[Trial], tolerance_mm: float) -> Choice:
    """Choose by :data:`RULES`.

    Examples
    --------
    >>> quick = Trial("quick", False, 1, True, bound_mm=0.2, measured_mm=0.1, seconds=1.0)
    >>> sound = Trial("sound", True, 9, True, bound_mm=0.0, measured_mm=0.0, seconds=5.0)
    >>> choose([quick, sound], tolerance_mm=0.1).reasons["quick"]
    'its bound of 0.2 mm is over the tolerance of 0.1 mm'
    """
    reasons = {trial.name: unfit(trial, tolerance_mm) for trial in trials}
    fit = ranked([trial for trial in trials if not reasons[trial.name]])
    for place, trial in enumerate(fit):
        reasons[trial.name] = _place_reason(fit, place)
    names = [trial.name for trial in fit[:2]] + ["", ""]
    return Choice(names[0], names[1], reasons)


def unfit(trial: Trial, tolerance_mm: float) -> str:
    """Why a slicer cannot be chosen; empty where it can."""
    if not trial.available:
        return f"it is not available: {trial.why}"
    if trial.why:
        return trial.why
    for what, value in (("bound", trial.bound_mm), ("measured error", trial.measured_mm)):
        if value != value:
            return f"its {what} is not known: there is no layer on which it can be judged"
        if value > tolerance_mm:
            return f"its {what} of {value:.4g} mm is over the tolerance of {tolerance_mm:g} mm"
    return ""


def ranked(trials: Sequence[Trial]) -> list[Trial]:
    """Fastest first; from those that tie with the fastest left, the one of the highest priority."""
    left = list(trials)
    order = []
    while left:
        fastest = min(trial.seconds for trial in left)
        tied = [trial for trial in left if trial.seconds <= (1.0 + TIE_SHARE) * fastest]
        best = min(tied, key=lambda trial: (-trial.priority, trial.name))
        order.append(best)
        left.remove(best)
    return order


def _place_reason(fit: Sequence[Trial], place: int) -> str:
    trial, best = fit[place], fit[0]
    if place == 0:
        others = [t for t in fit[1:] if t.seconds <= (1.0 + TIE_SHARE) * trial.seconds]
        tied = (
            f", of the highest priority among those as fast ({', '.join(t.name for t in others)})"
            if others
            else ""
        )
        return f"primary: the fastest that meets the tolerance{tied}"
    slower = f"{trial.seconds:.3g} s against {best.seconds:.3g} s of {best.name}"
    return f"witness: the next after {best.name} ({slower})" if place == 1 else f"not needed: {slower}"
