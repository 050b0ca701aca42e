"""The audit reports what is wrong, and nothing else."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrow.io.audit import audit, audit_arrays
from jaxgrow.transfer.device import get


def with_particle(growth, index, position):
    state = eqx.tree_at(
        lambda s: s.particles.position,
        growth.state,
        growth.state.particles.position.at[index].set(jnp.asarray(position)),
    )
    return dataclasses.replace(growth, state=state)


def test_grown_polyp_is_clean(tiny_polyp):
    found = audit(tiny_polyp)
    assert found.clean, found.defects
    assert found.particles == int(get(tiny_polyp.state.particles.alive).sum())
    assert found.surface.clean
    assert found.euler_number_before == found.surface.euler_number


def test_particle_outside_is_reported(tiny_polyp):
    axis = get(tiny_polyp.state.frame.axis)
    found = audit(with_particle(tiny_polyp, 7, 3.0 * axis))
    assert found.defects == {"particles_outside": 1}
    assert not found.clean


def test_particle_that_is_not_finite_is_reported(tiny_polyp):
    found = audit(with_particle(tiny_polyp, 3, [0.0, np.nan, 0.0]))
    assert found.defects["non_finite_particles"] == 1


def test_flipped_face_is_reported(tiny_polyp):
    position, _ = tiny_polyp.particles()
    vertices, faces, _ = tiny_polyp.surface()
    faces = faces.copy()
    faces[11] = faces[11][::-1]
    found = audit_arrays(position, vertices, faces, tiny_polyp.organ.tissue)
    assert found.defects["misoriented_edges"] == 3


def test_hole_is_reported(tiny_polyp):
    position, _ = tiny_polyp.particles()
    vertices, faces, _ = tiny_polyp.surface()
    organ = tiny_polyp.organ
    euler = len(organ.vertices) - len(organ.faces) // 2
    found = audit_arrays(position, vertices, faces[1:], organ.tissue, euler)
    assert found.defects["boundary_edges"] == 3
    assert found.defects["euler_number_change"] == 1


def test_surface_through_itself_is_reported(tiny_polyp):
    membrane = tiny_polyp.state.membrane
    vertices, axis = get(membrane.vertices), get(tiny_polyp.state.frame.axis)
    far = np.where(get(membrane.free), np.linalg.norm(vertices, axis=1), np.inf)
    source = int(far.argmin())
    gap = np.linalg.norm(vertices - vertices[source], axis=1)
    other = int(np.abs(gap - 3).argmin())
    # two vertices change places, a little above: their fans cross
    pushed = membrane.vertices.at[jnp.asarray([source, other])].set(
        jnp.asarray(vertices[[other, source]] + axis)
    )
    state = eqx.tree_at(lambda s: s.membrane.vertices, tiny_polyp.state, pushed)
    found = audit(dataclasses.replace(tiny_polyp, state=state))
    assert not found.clean
    intersections = {"self_intersections", "hinged_intersections"}
    assert intersections & set(found.defects)


def test_free_cluster_has_no_surface_to_audit(tiny_cluster):
    found = audit(tiny_cluster)
    assert found.clean
    assert found.surface is None
    assert found.particles == 5


def test_report_holds_all_figures(tiny_polyp):
    figures = audit(tiny_polyp).as_dict()
    assert figures["clean"] is True
    assert figures["defects"] == {}
    assert figures["particles_outside"] == 0
    assert figures["surface"]["self_intersections"] == 0
