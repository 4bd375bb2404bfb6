"""Layers while a build goes on: sliced at the measured height, planned on the heat so far, proved and published."""
