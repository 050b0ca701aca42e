"""Lesions on a flat patch, from any triangle mesh."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.mesh.surface import Surface
from jaxgrow.state import FormerSurface, Frame, State
from jaxgrow.transfer.device import put_membrane, put_particles

from .polyhedra import PROFILES, revolve


PARTICLES = np.array(
    [[0, 0, -2.0], [0, 0, -0.25], [1, 0, 0.4], [0, 1, 1.0], [0, 0, 9.0]]
)


def _make_state(surface, former, *, turn=None, shift=(0, 0, 0), mm=1.0):
    """A state with this membrane and former surface, four tumour particles, one other.

    Args:
        surface: vertices, faces and rim of the membrane.
        former: vertices and faces.
        turn: rotation of everything; then `shift` moves all but the site.
        shift: translation.
        mm: r0 in mm.
    """
    turn = np.eye(3) if turn is None else turn
    vertices, faces, rim = surface
    membrane = put_membrane(Surface(vertices @ turn.T + shift, faces, rim))
    particles = put_particles(
        PARTICLES @ turn.T + shift, np.array([1, 1, 1, 1, 0]), np.zeros(5, bool), 8
    )
    frame = Frame(
        jnp.zeros(3),
        jnp.asarray(turn[:, 2]),
        jnp.asarray(mm),
        FormerSurface(jnp.asarray(former[0] @ turn.T + shift), jnp.asarray(former[1])),
    )
    return State(particles, membrane, frame)


@pytest.fixture(scope="session")
def make_state():
    return _make_state


@pytest.fixture(scope="session")
def lesion(make_state):
    """The state of a lesion with a profile; all have the same shapes of arrays."""

    def of(name, **where):
        rings, tip = PROFILES[name]
        return make_state(revolve(rings, tip), revolve(rings[:1], 0.0)[:2], **where)

    return of
