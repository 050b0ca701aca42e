"""Synthetic polyps and myomas, grown into the surface mesh of an organ.

Names are resolved lazily: ``import jaxgrow as jg`` imports neither JAX nor a submodule;
a submodule is imported when a name of it is first used. The names are in
``__init__.pyi``.
"""

from typing import Any

import lazy_loader


_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Import the object behind a public name at its first use (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("jaxgrow")
        except PackageNotFoundError:  # run from a checkout without an installation
            return "unknown"
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _attribute(name)
