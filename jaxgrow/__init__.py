"""Grows synthetic polyps and myomas into the surface mesh of an organ.

``import jaxgrow as jg`` does nothing but name things: what is behind a name (and with
it JAX) is imported when the name is first used.
"""

import importlib
import sys
from types import ModuleType
from typing import Any, TYPE_CHECKING


if TYPE_CHECKING:
    from jaxgrow.audit import Audit as Audit, audit as audit
    from jaxgrow.calibration import (
        Bounds as Bounds,
        Fit as Fit,
        fit as fit,
        FitError as FitError,
        Target as Target,
    )
    from jaxgrow.compile_cache import keep_programs as keep_programs
    from jaxgrow.constructors import (
        make_membrane as make_membrane,
        make_particles as make_particles,
    )
    from jaxgrow.energy.a2 import A2 as A2
    from jaxgrow.energy.term import (
        Elements as Elements,
        MembraneTerm as MembraneTerm,
        Term as Term,
    )
    from jaxgrow.ensemble import grow_many as grow_many
    from jaxgrow.equilibrium.compliance import (
        linear_response as linear_response,
        LinearResponse as LinearResponse,
    )
    from jaxgrow.equilibrium.relax import relax as relax, Relaxation as Relaxation
    from jaxgrow.grow import grow as grow
    from jaxgrow.growth import Growth as Growth, Progress as Progress
    from jaxgrow.metrics import shape_metrics as shape_metrics
    from jaxgrow.organ.loading import load_organ as load_organ
    from jaxgrow.organ.organ import Organ as Organ
    from jaxgrow.organ.uterus import uterus as uterus
    from jaxgrow.organ.validity import OrganError as OrganError
    from jaxgrow.parameters import (
        Parameters as Parameters,
        UnstableAdhesionWarning as UnstableAdhesionWarning,
    )
    from jaxgrow.render import (
        render_growth as render_growth,
        render_surface as render_surface,
    )
    from jaxgrow.results import Result as Result
    from jaxgrow.run_folder import (
        audit_run as audit_run,
        read_run as read_run,
        write_run as write_run,
    )
    from jaxgrow.scene import (
        load_scene as load_scene,
        make_scene as make_scene,
        Myoma as Myoma,
        Polyp as Polyp,
        Scene as Scene,
        SceneError as SceneError,
        Surroundings as Surroundings,
    )
    from jaxgrow.slow_path import (
        SlowPathWarning as SlowPathWarning,
        UnvalidatedVersionWarning as UnvalidatedVersionWarning,
    )
    from jaxgrow.state import (
        Membrane as Membrane,
        Nodes as Nodes,
        Particles as Particles,
        Species as Species,
        State as State,
    )


_HOME = {
    "A2": "energy.a2",
    "Audit": "audit",
    "Bounds": "calibration.task",
    "Elements": "energy.term",
    "Fit": "calibration.outcome",
    "FitError": "calibration.task",
    "Growth": "growth",
    "LinearResponse": "equilibrium.compliance",
    "Membrane": "state",
    "MembraneTerm": "energy.term",
    "Myoma": "scene",
    "Nodes": "state",
    "Organ": "organ.organ",
    "OrganError": "organ.validity",
    "Parameters": "parameters",
    "Particles": "state",
    "Polyp": "scene",
    "Progress": "growth",
    "Relaxation": "equilibrium.relax",
    "Result": "results",
    "Scene": "scene",
    "SceneError": "scene",
    "SlowPathWarning": "slow_path",
    "Species": "state",
    "State": "state",
    "Surroundings": "scene",
    "Target": "calibration.task",
    "Term": "energy.term",
    "UnstableAdhesionWarning": "parameters",
    "UnvalidatedVersionWarning": "slow_path",
    "audit": "audit",
    "audit_run": "run_folder",
    "fit": "calibration.fit",
    "grow": "grow",
    "grow_many": "ensemble",
    "keep_programs": "compile_cache",
    "linear_response": "equilibrium.compliance",
    "load_organ": "organ.loading",
    "load_scene": "scene",
    "make_membrane": "constructors",
    "make_particles": "constructors",
    "make_scene": "scene",
    "read_run": "run_folder",
    "relax": "equilibrium.relax",
    "render_growth": "render",
    "render_surface": "render",
    "shape_metrics": "metrics",
    "uterus": "organ.uterus",
    "write_run": "run_folder",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


class _Package(ModuleType):
    """This package, with `jaxgrow.grow` the function and not the module around it.

    Python binds a submodule to its name in the package when it is first imported,
    whoever imports it; for the names of functions that is refused.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if name in _HOME and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    """Import what a name stands for, at its first use (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("jaxgrow")
        except PackageNotFoundError:  # run from a checkout without an installation
            return "unknown"
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, for completion."""
    return [*__all__, "__version__"]
