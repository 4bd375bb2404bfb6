"""Memory of a server that leads a control by OPC UA over hundreds of layers: it does not grow with them."""

import socket

import pytest

from benchmarks.live_memory import followed, growth_kb, made_run

LAYERS = 320

MOST_KB = 12.0
"""A layer that was kept would be tens of kilobytes; the allocator's own noise comes to a few."""


@pytest.mark.slow
def test_memory_does_not_grow_over_hundreds_of_layers_on_a_control(tmp_path):
    pytest.importorskip("asyncua", reason="needs the extra opcua: pip install 'ebamcheck[opcua]'")
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{found.getsockname()[1]}"
    seen = list(followed(made_run(tmp_path, LAYERS), tmp_path, url))
    assert seen[-1].layer >= 300
    assert growth_kb(seen) < MOST_KB
