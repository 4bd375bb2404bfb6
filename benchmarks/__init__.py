"""Benchmarks: each module that can be run is one command of docs/benchmarks.md, and writes its tables into reports/.

``python -m benchmarks`` times every slicer on two series of meshes (:mod:`~benchmarks.ladder`) and holds the figures against
targets (:mod:`~benchmarks.targets`). Every figure is taken in a fresh process (:mod:`~benchmarks.worker`) whose kernels are warm,
methods take turns so that a machine that slows down slows all of them, and what could not be measured is said in its place.
"""
