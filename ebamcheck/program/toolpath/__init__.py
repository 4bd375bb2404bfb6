"""What a program is to lay, before any control writes it: tracks of beads, wire, events."""
