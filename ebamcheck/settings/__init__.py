"""The sections of the settings: every number that a stage uses, with its unit and its reason."""
