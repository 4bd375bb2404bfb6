"""A finished run, or a program, worked out again and held against what it says."""
