"""Memory of a server over its layers: of a layer that is laid a few numbers of the heat column stay, and nothing else."""

from __future__ import annotations

import io
import json
import socket
import sys

import numpy as np
import pytest

from benchmarks.live_memory import followed, growth_kb, made_run
from ebamcheck.live.building import Building, Lines, serve
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.relaying import finished_run
from ebamcheck.testing.played_control.program import Growth

SETTLED, LAYERS = 30, 50
"""Layers after which all is loaded, the texts of the last 64 sections of settings among it; and layers of the column."""

MOST_BLOCKS = 8.0
"""Blocks of memory that a layer may leave, of the hundred thousand that it takes. The heat column keeps six numbers of each cell,
joins those far below, and has them in arrays that are there already; this test keeps two blocks. What is not collected after each
layer comes to thirty."""

MOST_KB = 4.1
"""Resident memory that a layer may leave: the least that can be seen, a page."""


class Heights(Lines):
    """Lines with the heights of layers that grow by a law; memory is read when the server waits for the next one."""

    def __init__(self, out: io.StringIO, growth: Growth) -> None:
        self._out, self._growth, self.blocks = out, growth, {}

    def next(self, wait_s: float | None) -> bytes | None:
        text = self._out.getvalue()
        self._out.seek(0)
        self._out.truncate()
        if not text:
            return b'{"event": "start"}'
        answer = json.loads(text)
        if answer["answer"] != "published":
            assert answer["answer"] == "done", answer
            raise EOFError
        layer = answer["layer"]
        self.blocks[layer] = sys.getallocatedblocks()
        height_mm = answer["base_mm"] + self._growth.grown_mm(layer - 1, answer["thickness_mm"])
        return json.dumps({"event": "height", "done": layer, "height_mm": height_mm}).encode()


@pytest.mark.slow
def test_no_layer_leaves_anything_in_a_server_of_lines(tmp_path):
    found = finished_run(made_run(tmp_path, LAYERS))
    out = io.StringIO()
    lines = Heights(out, Growth(0.02, 0.05, 1))
    with LayerMaker(found.part, found.config, found.primary) as maker:
        building = Building(maker, tmp_path / "b")
        try:
            serve(building, lines, out, 60.0)
        finally:
            building.close()
    layers = np.array([layer for layer in lines.blocks if layer >= SETTLED])
    assert len(layers) >= 18
    slope = np.polyfit(layers, [lines.blocks[layer] for layer in layers], 1)[0]
    assert abs(slope) < MOST_BLOCKS, lines.blocks


@pytest.mark.long
def test_memory_does_not_grow_over_layers_on_a_control(tmp_path):
    pytest.importorskip("asyncua", reason="needs the extra opcua: pip install 'ebamcheck[opcua]'")
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{found.getsockname()[1]}"
    seen = list(followed(made_run(tmp_path, 160), tmp_path, url))
    assert seen[-1].layer >= 150
    assert growth_kb(seen) < MOST_KB
