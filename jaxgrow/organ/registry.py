"""Registry of the organs that a scene names."""

from collections.abc import Callable
from typing import TypeVar

from jaxgrow.organ.organ import Organ
from jaxgrow.organ.uterus import uterus


ORGANS: dict[str, Callable[[], Organ]] = {"uterus": uterus}
"""Functions that make an organ, by the name that a scene and the command use."""

_Maker = TypeVar("_Maker", bound=Callable[[], Organ])


def register_organ(make: _Maker) -> _Maker:
    """Register an organ for scenes, scene files and the command.

    It may be used as a decorator of the function, whose name is that of the organ. An
    organ of the same name is replaced.

    Args:
        make: a function without arguments that returns an `Organ`.

    Raises:
        TypeError: it is not a function with a name.
    """
    name = getattr(make, "__name__", "")
    if not (callable(make) and name.isidentifier()):
        raise TypeError(
            f"{make!r} is no maker of an organ; give a function without arguments "
            "whose name is that of the organ."
        )
    ORGANS[name] = make
    return make


def make_organ(name: str) -> Organ:
    """Make a registered organ.

    Raises:
        TypeError: the registered function did not return an organ.
    """
    organ = ORGANS[name]()
    if not isinstance(organ, Organ):
        raise TypeError(
            f"the function of the organ {name!r} returned {type(organ).__name__}; it "
            "must return a jaxgrow.Organ."
        )
    return organ
