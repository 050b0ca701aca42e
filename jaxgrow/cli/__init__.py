"""Command ``jaxgrow``."""
