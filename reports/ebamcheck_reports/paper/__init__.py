"""``ebamcheck paper``: the paper's figures and numbers, reproduced on stand-in parts and compared with its own.

The paper: "Slicing Algorithm and Partition Scanning Strategy for 3D Printing Based on GPU Parallel Computing".
"""

from ebamcheck_reports.paper.command import paper

__all__ = ["paper"]
