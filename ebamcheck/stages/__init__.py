"""Single stages of the job as commands: ``ebamcheck fit``, ``ebamcheck scan`` and ``ebamcheck post``."""
