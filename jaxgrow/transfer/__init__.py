"""Arrays between host and device: checked, padded, put and got."""
