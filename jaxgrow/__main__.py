"""``python -m jaxgrow`` is the command ``jaxgrow``."""

import sys

from jaxgrow.cli.main import command


sys.exit(command())
