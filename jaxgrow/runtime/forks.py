"""Refusal to compute in forked processes.

XLA computes on threads, and a fork copies none of them: the first program of a child
whose parent had computed would never end.
"""

import os


_computes_in: int | None = None
"""Number of the process that computed first; its forked children inherit it."""


def refuse_forked() -> None:
    """Refuse to compute in a process forked from one that computed.

    Raises:
        RuntimeError: this is such a process.
    """
    global _computes_in
    here = os.getpid()
    if _computes_in is None:
        _computes_in = here
    if _computes_in != here:
        raise RuntimeError(
            "this process was forked from one that had grown or relaxed something, and "
            "XLA, whose threads a fork does not copy, would hang in it; start it by "
            'multiprocessing.get_context("spawn"), or use jaxgrow.grow_many.'
        )
