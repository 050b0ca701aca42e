"""Loops compiled by numba as handlers of XLA's foreign function interface.

An XLA program calls a handler without the Python interpreter and with its own buffers:
it is no host callback, runs on any thread, and leaves the program cacheable on disk.
The handler is given a *call frame*, of which this module knows the layout (version 0.x
of ``xla/ffi/api/c_api.h``, 64 bits)::

    frame     size, extension, api, context, stage, arguments, results, ...
    arguments size, extension, count, types, pointers to buffers (results likewise)
    buffer    size, extension, type, data, rank, pointer to its dimensions
    extension size, type, next, pointer to metadata (of a query of the version)
    metadata  size, version (size, extension, major and minor), ...
    api       size, extension, version (likewise), ...

each entry a word of 64 bits. Another major version is refused by XLA when a handler is
registered, and `registered` tells so.
"""

import ctypes
import functools
from importlib import import_module
from typing import Any

import jax

from jaxgrow.kernels import wanted


_new_capsule = ctypes.PYFUNCTYPE(
    ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
)(("PyCapsule_New", ctypes.pythonapi))


def target(name: str) -> str:
    """What XLA knows the handler of that name by."""
    return f"jaxgrow_{name}"


@functools.cache
def registered(name: str) -> bool:
    """Whether XLA can call the handler of that name now; registered at the first call.

    Args:
        name: of a module of `jaxgrow.kernels` with a handler.
    """
    if not wanted():
        return False
    try:
        # not above: numba takes half a second to import
        handler: Any = import_module(f"jaxgrow.kernels.{name}").handler
        capsule = _new_capsule(handler.address, None, None)
        jax.ffi.register_ffi_target(target(name), capsule, platform="cpu")
    # XLA refuses handlers for another version by an error of its own
    except Exception:
        return False
    return True
