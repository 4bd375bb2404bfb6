"""Checks of a program that was read back: path, state, metal, heat, text."""
