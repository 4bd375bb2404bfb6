"""Slicing with one backend, in this process or in one of its own."""
