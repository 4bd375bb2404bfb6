"""The text of an NC program: its codes and files, and its motions, beads and times as they are read back."""
