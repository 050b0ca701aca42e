import numpy as np
import pytest
import trimesh

from jaxgrow.organ.organ import Organ
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
