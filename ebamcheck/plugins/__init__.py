"""What strangers add: the registry of entry points, and the protocol of a reference model."""
