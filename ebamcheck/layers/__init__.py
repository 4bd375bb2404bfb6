"""Layers: the contours of a stack, their heights, their canonical form, and their files."""
