"""Entry point of ``python -m jaxgrow``: the command ``jaxgrow``."""

import sys

from jaxgrow.cli.main import command


sys.exit(command())
