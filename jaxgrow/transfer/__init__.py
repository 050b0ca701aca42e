"""Arrays between host and device: checks, padding, `put_*` and `get_*`."""
