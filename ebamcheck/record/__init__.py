"""The run folder: its record, its certificate, and who signs it."""
