"""``python -m jaxgrow`` is the command ``jaxgrow``."""

import sys

from jaxgrow.cli import command


sys.exit(command())
