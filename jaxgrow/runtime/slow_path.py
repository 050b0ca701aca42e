"""Warnings about slow paths and unvalidated versions.

Each sentence is issued once per process.
"""

import functools
import warnings


class SlowPathWarning(UserWarning):
    """Warning of a condition that makes growths slower than they could be."""


class UnvalidatedVersionWarning(UserWarning):
    """Warning of a jaxlib that the compiled loops are untested with."""


@functools.cache
def warn_once(sentence: str, category: type[Warning] = SlowPathWarning) -> None:
    """Issue a warning, once per process for each sentence.

    Args:
        sentence: what happened, what it costs and what to do.
        category: of the warning.
    """
    warnings.warn(sentence, category, stacklevel=3)
