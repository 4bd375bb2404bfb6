"""Controls: the words of each, how programs are written for it, and how they are read back."""
