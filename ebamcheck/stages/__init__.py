"""Single stages of the job as commands: ``ebamcheck fit`` and ``ebamcheck post``."""
