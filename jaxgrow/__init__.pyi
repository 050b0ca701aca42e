"""The public names, and where each is."""

from .calibration.fit import fit as fit
from .calibration.outcome import Fit as Fit
from .calibration.spec import Bounds as Bounds, FitError as FitError, Target as Target
from .energy.a2 import A2 as A2
from .energy.parameters import (
    Parameters as Parameters,
    PRINTED as PRINTED,
    UnstableAdhesionWarning as UnstableAdhesionWarning,
)
from .energy.term import (
    Elements as Elements,
    MembraneTerm as MembraneTerm,
    Term as Term,
)
from .ensemble.grow_many import grow_many as grow_many
from .equilibrium.descent import Minimiser as Minimiser
from .equilibrium.linear_response import (
    linear_response as linear_response,
    LinearResponse as LinearResponse,
)
from .equilibrium.relax import relax as relax, Relaxation as Relaxation
from .equilibrium.relaxers import register_relaxer as register_relaxer
from .growth.grow import grow as grow, GrowthInterrupted as GrowthInterrupted
from .growth.history import StepRecord as StepRecord
from .growth.progress import Progress as Progress
from .growth.result import Growth as Growth
from .io.audit import Audit as Audit, audit as audit
from .io.formats.format import (
    MeshFormat as MeshFormat,
    SurfaceMesh as SurfaceMesh,
)
from .io.formats.registry import register_format as register_format
from .io.lesion_surface import (
    lesion_surface as lesion_surface,
    LesionSurface as LesionSurface,
    RefinementError as RefinementError,
)
from .io.run_folder import (
    audit_run as audit_run,
    read_run as read_run,
    write_run as write_run,
)
from .lesions.division import Division as Division
from .lesions.lesion import Lesion as Lesion
from .lesions.myoma import Myoma as Myoma
from .lesions.polyp import Polyp as Polyp
from .metrics import (
    register_metric as register_metric,
    shape_metrics as shape_metrics,
)
from .organ.loading import load_organ as load_organ
from .organ.organ import Organ as Organ
from .organ.registry import register_organ as register_organ
from .organ.uterus import uterus as uterus
from .organ.validity import OrganError as OrganError
from .render import render_growth as render_growth, render_surface as render_surface
from .runtime.compile_cache import keep_programs as keep_programs
from .runtime.entries import SceneError as SceneError
from .runtime.results import Result as Result
from .runtime.slow_path import (
    SlowPathWarning as SlowPathWarning,
    UnvalidatedVersionWarning as UnvalidatedVersionWarning,
)
from .scene.scene import (
    load_scene as load_scene,
    make_scene as make_scene,
    register_lesion as register_lesion,
    Scene as Scene,
    Surroundings as Surroundings,
)
from .state import (
    Membrane as Membrane,
    Nodes as Nodes,
    Particles as Particles,
    Species as Species,
    State as State,
)
from .transfer.constructors import (
    make_membrane as make_membrane,
    make_particles as make_particles,
)

__version__: str
