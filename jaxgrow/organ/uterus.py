"""Built-in organ: a uterine cavity, distended as in hysteroscopy.

The cavity is a smooth union of round cones, flattened from front to back towards the
fundus: two horns, the arch of the fundus, the body that narrows to the internal os, and
the spindle of the cervical canal, closed by a cap at the external os. It is straight
(no ante-flexion) and symmetric.

Axes, in mm: x to the patient's left, y to the back, z to the head; the internal os is
at the origin.

Every dimension below is measured on the mesh by the tests.
"""

import functools
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.organ.implicit_surface import project, round_cone, smooth_union
from jaxgrow.organ.organ import Organ, OrganError
from jaxgrow.organ.tessellation import tessellate


CAVITY_LENGTH_MM = 32.0
"""Internal os to fundus; 26-38 mm in 172 women by 3-D ultrasound
(doi 10.22541/au.160288176.65195911)."""

CAVITY_WIDTH_MM = 32.0
"""Between the horns; 25-40 mm (the same study), mean 32 mm after a birth and 27 mm
before (doi 10.1097/AOG.0b013e3181e6cc10)."""

INTERNAL_OS_MM = 5.0
"""Width at the internal os; 4-11 mm (the ultrasound study)."""

DEPTH_MM = 14.0
"""Front to back, distended; 6-38 mm for 5-10 ml of fluid (Goldstuck 2018, Int J Womens
Health 10:165-168). The undistended cavity is a slit."""

CANAL_LENGTH_MM = 25.0
"""Cervical canal, internal to external os; about 25 mm in textbooks."""

CORNUAL_ANGLE_DEG = 65.0
"""Angle between the line of the horns and the lateral wall; 39-88 degrees (the
ultrasound study)."""

CORONAL_AREA_MM2 = 520.0
"""Area of the cavity in the coronal plane; 550 ± 130 mm² (the ultrasound study)."""

INDENTATION_MM = 2.2
"""Indentation of the lateral wall against the straight line from horn to internal os;
0.8-6.4 mm (the ultrasound study)."""

FINEST_MM, COARSEST_MM = 0.4, 1.5
"""Range of edge lengths of the tessellation: the horns' tips have a radius of curvature
of about 2 mm."""

KEPT_EDGE_MM = 1.0
"""Edge length of the mesh in the package; computing it takes a second."""

_KEPT = Path(__file__).with_name("uterus.npz")

FLATTENING = 0.78
"""Depth over width of the round cones in the cavity; the canal is round."""

BLEND_MM = 0.9
"""Width of the rounded seams between the parts."""

# start x and z, end x and z, radius at start and end: fitted to the dimensions above
_PARTS = (
    (13.9, 28.7, 2.0, 20.0, 2.1, 7.8),
    (-13.9, 28.7, -2.0, 20.0, 2.1, 7.8),
    (-7.0, 25.6, 7.0, 25.6, 6.2, 6.2),
    (0.0, 21.5, 0.0, 4.5, 8.5, 2.5),
    (0.0, 4.5, 0.0, -11.0, 2.25, 3.05),
    (0.0, -11.0, 0.0, -23.1, 3.05, 1.9),
)

_SITES = {
    "fundus": (0.0, 0.0, 32.0),
    "left-cornu": (11.5, 0.0, 31.0),
    "right-cornu": (-11.5, 0.0, 31.0),
    "anterior": (0.0, -7.0, 20.0),
    "posterior": (0.0, 7.0, 20.0),
    "left-wall": (9.5, 0.0, 17.0),
    "right-wall": (-9.5, 0.0, 17.0),
    "isthmus": (0.0, 2.6, 2.0),
    "cervix": (0.0, 3.3, -12.0),
}


def cavity(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Evaluate the cavity's field: negative inside, about a distance in mm."""
    height = np.clip(points[:, 2] / 18, 0, 1)
    squeeze = 1 + (FLATTENING - 1) * height * height * (3 - 2 * height)
    round_points = points.copy()
    round_points[:, 1] /= squeeze
    distances = [
        round_cone(
            round_points,
            np.array([start_x, 0.0, start_z]),
            np.array([end_x, 0.0, end_z]),
            start_radius,
            end_radius,
        )
        for start_x, start_z, end_x, end_z, start_radius, end_radius in _PARTS
    ]
    return smooth_union(np.stack(distances), BLEND_MM)


def uterus(edge_mm: float = 1.0) -> Organ:
    """Build the cavity of a uterus with even triangles and named sites.

    With edges of 1 mm it is the same mesh everywhere, bit for bit: it is stored in
    ``uterus.npz``. With others it is computed, reproducibly on one machine. The sites
    are vertices. ``left-cornu`` and ``right-cornu`` lie on the wall of the fundus where
    the horn begins, where cornual polyps sit, not in the horn's tip.

    Args:
        edge_mm: Typical edge length of the triangles in mm.

    Returns:
        The organ; its tissue is outside the surface.

    Raises:
        OrganError: If the edges are too long for the horns or too short to be useful.
    """
    if not FINEST_MM <= edge_mm <= COARSEST_MM:
        msg = (
            f"the built-in uterus has edges between {FINEST_MM:g} and {COARSEST_MM:g} "
            f"mm, not {edge_mm:g} mm: choose one in this range."
        )
        raise OrganError(msg)
    vertices, faces = _tessellated(edge_mm)
    sites = dict(zip(_SITES, vertices[: len(_SITES)].copy(), strict=True))
    # the caller may change what it gets
    return Organ("uterus", vertices.copy(), faces.copy(), "outside", sites)


@functools.lru_cache(maxsize=4)
def _tessellated(
    edge_mm: float,
) -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, "f 3"]]:
    """Return vertices, the sites first, and faces; cached per process."""
    if edge_mm != KEPT_EDGE_MM:
        return make(edge_mm)
    with np.load(_KEPT) as kept:
        return kept["vertices"], kept["faces"].astype(np.int64)


def keep() -> None:
    """Write the stored mesh, after a change of the definitions above.

    ``python -c "from jaxgrow.organ.uterus import keep; keep()"``
    """
    vertices, faces = make(KEPT_EDGE_MM)
    np.savez_compressed(_KEPT, vertices=vertices, faces=faces.astype(np.int32))


def make(
    edge_mm: float,
) -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, "f 3"]]:
    """Tessellate the cavity: vertices, the sites first, and faces."""
    low = np.array([-18.0, -10.0, -28.0])
    high = np.array([18.0, 10.0, 35.0])
    pinned = project(cavity, np.array(list(_SITES.values())), step=1e-4, iterations=8)
    # a fixed seed: the built-in organ is one organ, not a random one
    rng = np.random.default_rng(0)
    return tessellate(cavity, low, high, edge_mm, rng, pinned)
