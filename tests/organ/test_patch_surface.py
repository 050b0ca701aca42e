from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.quality import areas
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold
from jaxgrow.organ import (
    cut_patch,
    extend_lining,
    line_patch,
    Lining,
    locate_site,
    merge,
    OrganError,
    widen_patch,
)


AREAS = {"max_area": 0.7, "min_area": 0.1}
NOBODY = np.zeros((0, 3))


@pytest.fixture(scope="module")
def patch(womb):
    return cut_patch(womb, locate_site(womb, "fundus"), 6.5, r0_mm=1.0)


@pytest.fixture(scope="module")
def lining(womb, patch):
    return line_patch(womb, patch, **AREAS)


def joined(organ, patch, lining):
    surface = lining.surface
    return merge(
        organ,
        patch,
        patch.to_mm(surface.vertices),
        surface.faces,
        lining.organ_index,
    )


def test_the_lining_is_fine_and_keeps_the_rim(patch, lining):
    surface, index = lining
    assert areas(surface.vertices[surface.faces]).max() <= 0.7
    np.testing.assert_array_equal(
        np.sort(index[surface.fixed]), patch.organ_index[patch.rim]
    )
    place = np.searchsorted(patch.organ_index, index[surface.fixed])
    np.testing.assert_array_equal(
        surface.vertices[surface.fixed], patch.vertices[place]
    )
    assert surface.source == -1


def test_the_lining_fits_into_the_organ(womb, patch, lining):
    merged = joined(womb, patch, lining)
    assert audit_surface(merged.vertices, merged.faces).clean


def test_the_ring_is_as_fine_as_the_lining(womb, patch, lining):
    wider = widen_patch(womb, patch, 9.0)
    surface, _ = extend_lining(lining, womb, patch, wider, NOBODY, **AREAS)
    ring = surface.faces[len(lining.surface.faces) :]
    assert len(ring) > 100
    assert areas(surface.vertices[ring]).max() <= 0.7


def test_the_ring_leaves_the_surface_of_the_organ_alone(womb, patch, lining):
    wider = widen_patch(womb, patch, 9.0)
    surface, index = extend_lining(lining, womb, patch, wider, NOBODY, **AREAS)
    count = len(lining.surface.vertices)
    known = count + np.flatnonzero(index[count:] >= 0)
    assert len(known) > 20
    place = np.searchsorted(wider.organ_index, index[known])
    np.testing.assert_array_equal(surface.vertices[known], wider.vertices[place])


def notched(organ):
    """A patch with a notch: a vertex w on its rim with one triangle outside.

    Returns the patch, and w with its neighbours u and v on the rim.
    """
    patch = cut_patch(organ, locate_site(organ, "fundus"), 6.5, r0_mm=1.0)
    inner = ~patch.rim[patch.faces]
    row = int(np.flatnonzero(inner.sum(axis=1) == 1)[0])
    mask = patch.face_mask.copy()
    mask[np.flatnonzero(mask)[row]] = False
    faces = np.delete(patch.faces, row, axis=0)
    rim = build_topology(faces, len(patch.vertices)).rim_vertices
    w = int(patch.faces[row][inner[row]][0])
    u, v = (int(i) for i in patch.faces[row][~inner[row]])
    return replace(patch, face_mask=mask, faces=faces, rim=rim), w, {u, v}


def with_edge_across(patch, w, ends):
    """The patch as a membrane whose triangles at w lie before an edge from u to v."""
    mine = (patch.faces == w).any(axis=1)
    start = np.argmax(patch.faces[mine] == w, axis=1)[:, None]
    fan = np.take_along_axis(patch.faces[mine], (start + np.arange(3)) % 3, axis=1)
    after = {int(a): int(b) for _, a, b in fan}
    (u,) = set(after) & ends
    path = [u]
    while path[-1] in after:
        path.append(after[path[-1]])
    v, middle = path[-1], len(patch.vertices)
    assert {u, v} == ends
    new = [(w, u, middle), (w, middle, v), (middle, u, v)]
    new += [(u, a, b) for a, b in pairwise(path[1:])]
    at = patch.vertices[[w, u, v]].mean(axis=0)
    surface = Surface(
        np.concatenate([patch.vertices, at[None]]),
        np.concatenate([patch.faces[~mine], np.array(new)]),
        np.append(patch.rim, False),
    )
    return Lining(surface, np.append(patch.organ_index, -1))


def test_an_edge_that_both_sides_of_the_old_rim_have_is_split(womb):
    patch, w, ends = notched(womb)
    lining = with_edge_across(patch, w, ends)
    assert is_manifold(lining.surface.faces, len(lining.organ_index))
    wider = widen_patch(womb, patch, 1.0)
    surface, _ = extend_lining(
        lining, womb, patch, wider, NOBODY, max_area=1e3, min_area=0.0
    )
    assert is_manifold(surface.faces, len(surface.vertices))


def test_a_membrane_with_a_handle_is_refused(womb, patch, lining):
    surface, index = lining
    inner = ~surface.fixed[surface.faces].any(axis=1)
    first = int(np.flatnonzero(inner)[0])
    apart = ~np.isin(surface.faces, surface.faces[first]).any(axis=1)
    second = int(np.flatnonzero(inner & apart)[-1])
    (a, b, c), (d, f, e) = surface.faces[first], surface.faces[second]
    tube = [(a, b, d), (b, e, d), (b, c, e), (c, f, e), (c, a, f), (a, d, f)]
    faces = np.delete(surface.faces, [first, second], axis=0)
    faces = np.concatenate([faces, np.array(tube)])
    assert is_manifold(faces, len(index))
    assert euler_number(faces) == -1
    handle = Lining(Surface(surface.vertices, faces, surface.fixed), index)
    wider = widen_patch(womb, patch, 9.0)
    with pytest.raises(OrganError, match=r"it has -1, the patch 1\): .* handle"):
        extend_lining(handle, womb, patch, wider, NOBODY, **AREAS)
