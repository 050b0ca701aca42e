"""Warnings about a machine on which growths are slower, or less proven, than elsewhere.

Each sentence is said once in a process, whoever comes upon it first.
"""

import functools
import warnings


class SlowPathWarning(UserWarning):
    """Something that makes growths here slower than they could be."""


class UnvalidatedVersionWarning(UserWarning):
    """A version of jaxlib that the compiled loops have not been tested with."""


@functools.cache
def warn_once(sentence: str, category: type[Warning] = SlowPathWarning) -> None:
    """Warn of it, if nobody did before in this process.

    Args:
        sentence: what happened, what it costs and what to do.
        category: of the warning.
    """
    warnings.warn(sentence, category, stacklevel=3)
