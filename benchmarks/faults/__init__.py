"""Planted faults: what an enemy who knows the code changes in a finished program, and which checks find it.

``python -m benchmarks.faults`` makes finished runs of small parts for every control, plants some hundred faults by a seeded
script, has each run verified (`verify RUN`) and each program by itself with all comments taken out (`verify PROGRAM
--part`), and writes the tables of ``reports/faults``.
"""
