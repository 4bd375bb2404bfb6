"""Power along beads: that of their layer, and more where a bead lays more metal than that power melts."""

from __future__ import annotations

import numpy as np

from ebamcheck.heat.melting import own_power_shares
from ebamcheck.nc.inputs import Interpass
from ebamcheck.numeric.rings import Floats
from ebamcheck.scan.heat.part_heat import BeadPower
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_parts import Parts
from ebamcheck.writing.tracks import Toolpath


def layer_power(path: Toolpath, layer: int, rows: slice, share: float, config: Config) -> Floats:
    """Share of the full power along segments `rows` of one layer, which has a share of it."""
    own = own_power_shares(config, path.width[rows], float(path.thickness[layer]))
    return np.asarray(path.power[rows] * np.maximum(share, own), np.float64)


def power_shares(path: Toolpath, heat: Interpass, config: Config) -> Floats:
    """Share of the full power along every segment of a path, (N,)."""
    ends = path.track_starts[path.layer_starts].tolist()
    shares = heat.power_share.tolist()
    return np.concatenate(
        [
            np.zeros(0),
            *(layer_power(path, k, slice(*ends[k : k + 2]), s, config) for k, s in enumerate(shares)),
        ]
    )


def along_beads(parts: Parts, tracks: int, thickness_mm: float, config: Config) -> BeadPower:
    """Power along the tracks of one layer by the parts of their segments, for the heat of its plan."""
    length = parts.high - parts.low
    whole = np.bincount(parts.track, length, minlength=tracks)
    own = own_power_shares(config, parts.width, thickness_mm)
    return BeadPower(parts.track, parts.power * length / whole[parts.track], own)
