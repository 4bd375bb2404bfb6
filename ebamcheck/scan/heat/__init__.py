"""The heat of islands while a layer is scanned: modes, fresh heat, waits and power."""
