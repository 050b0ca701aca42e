import numpy as np
import pytest
import trimesh

from jaxgrow.organ.implicit_surface import round_cone
from jaxgrow.organ.organ import Organ
from jaxgrow.organ.tessellation import tessellate
from jaxgrow.organ.uterus import uterus


@pytest.fixture(scope="session")
def womb():
    return uterus()


@pytest.fixture(scope="session")
def ball():
    """A solid ball of radius 10 mm, tissue inside."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    vertices = np.array(mesh.vertices)
    faces = np.array(mesh.faces, dtype=np.int64)
    return Organ("ball", vertices, faces, "inside", {"top": vertices[0].copy()})


@pytest.fixture(scope="session")
def bubble(ball):
    """The same sphere as a lumen, tissue outside."""
    return Organ("bubble", ball.vertices, ball.faces, "outside", ball.sites)


@pytest.fixture(scope="session")
def tube():
    """A long capsule of radius 5 mm along z."""
    ends = np.array([[0.0, 0.0, -30.0], [0.0, 0.0, 30.0]])
    vertices, faces = tessellate(
        lambda points: round_cone(points, ends[0], ends[1], 5.0, 5.0),
        np.array([-7.0, -7.0, -37.0]),
        np.array([7.0, 7.0, 37.0]),
        1.5,
        np.random.default_rng(0),
    )
    return Organ("tube", vertices, faces)
