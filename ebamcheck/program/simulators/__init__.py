"""Cases of heat simulators: what a program is to a code that computes its heat."""
