"""How numeric kernels are compiled and kept, and kernels on rings of points."""
