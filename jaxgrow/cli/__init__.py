"""The command ``jaxgrow``."""
