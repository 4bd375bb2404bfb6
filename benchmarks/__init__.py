"""Benchmarks: how long slicing takes and how much memory it needs, for every slicer that this machine has.

    python -m benchmarks                 # the ladder, the second series at its top, and the table of targets
    python -m benchmarks --quick         # a few minutes: that it works, not how fast it is
    python -m benchmarks --gpu           # the stencil backend alone, under the renderer's name
    python -m benchmarks --scale         # ten million facets, ten thousand layers, under a memory watch

Every figure is taken in a fresh process whose kernels are warm, methods take turns so that a machine that slows down
slows all of them, and what could not be measured is said in its place. The modules, in the order of the work:

``parts``, ``even_mesh``
    The two series of meshes, and the other parts.
``methods``, ``yardsticks``
    What is measured: the backends of the registry, and two programs measured by themselves.
``watch``, ``worker``, ``timing``
    One measurement: a process under a limit, what it runs, and the clock.
``ladder``, ``target_tasks``, ``scale``
    Which measurements are taken, and in which order.
``overlap_cost``, ``latency``, ``bitmaps``, ``crossings``
    What the targets ask for beyond times.
``spread``, ``figures``, ``floors``, ``targets``, ``target_rows``, ``tables``, ``plot``, ``machine``
    What becomes of the figures.
"""
