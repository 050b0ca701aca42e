import numpy as np
import pytest
import trimesh

from jaxgrow.mesh.topology import euler_number, is_manifold
from jaxgrow.organ import cut_patch, locate_site, merge, Organ, OrganError
from jaxgrow.organ.validity import check_surface


@pytest.fixture(scope="module", params=["outside", "inside"])
def organ(request, womb):
    return Organ("womb", womb.vertices, womb.faces, request.param, womb.sites)


@pytest.fixture(scope="module")
def patch(organ):
    return cut_patch(organ, locate_site(organ, "fundus"), 8.0, r0_mm=0.7)


def grown(patch):
    """The patch with every inner triangle split in three and a bump raised on it."""
    inner = ~patch.rim[patch.faces].any(axis=1)
    cut = patch.faces[inner]
    middle = len(patch.vertices) + np.arange(len(cut))
    a, b, c = cut.T
    split = [
        np.stack(s, axis=1) for s in ((a, b, middle), (b, c, middle), (c, a, middle))
    ]
    faces = np.concatenate([patch.faces[~inner], *split])
    vertices = np.concatenate(
        [patch.vertices, patch.vertices[cut].mean(axis=1)], axis=0
    )
    reach = np.linalg.norm(vertices, axis=1)
    bump = 3 * np.exp(-((reach / 3) ** 2))[:, None] * patch.site.normal
    rim = np.concatenate([patch.rim, np.zeros(len(cut), dtype=bool)])
    vertices = np.where(rim[:, None], vertices, vertices + bump)
    index = np.concatenate([patch.organ_index, np.full(len(cut), -1)])
    return vertices, faces, index


def test_an_ungrown_patch_gives_the_organ_back(organ, patch):
    merged = merge(
        organ, patch, patch.to_mm(patch.vertices), patch.faces, patch.organ_index
    )
    assert np.array_equal(np.sort(merged.origin), np.arange(len(organ.vertices)))
    np.testing.assert_allclose(
        merged.vertices, organ.vertices[merged.origin], atol=1e-13
    )

    # the same triangles, whatever their order and their first corner
    def named(faces):
        turn = np.argmin(faces, axis=1)[:, None] + np.arange(3)
        return {tuple(f) for f in np.take_along_axis(faces, turn % 3, 1).tolist()}

    assert named(merged.origin[merged.faces]) == named(organ.faces)


def test_vertices_outside_the_patch_keep_order_and_every_bit(organ, patch):
    vertices, faces, index = grown(patch)
    merged = merge(organ, patch, patch.to_mm(vertices), faces, index)
    inner = np.isin(np.arange(len(organ.vertices)), patch.organ_index[~patch.rim])
    kept = np.flatnonzero(~inner)
    np.testing.assert_array_equal(merged.origin[: len(kept)], kept)
    np.testing.assert_array_equal(merged.vertices[: len(kept)], organ.vertices[kept])


def test_a_grown_surface_is_joined_without_a_seam(organ, patch):
    vertices, faces, index = grown(patch)
    merged = merge(organ, patch, patch.to_mm(vertices), faces, index)
    check_surface(merged.vertices, merged.faces, "merged")
    assert is_manifold(merged.faces, len(merged.vertices))
    assert euler_number(merged.faces) == euler_number(organ.faces)


def test_a_lesion_takes_room_from_the_lumen(organ, patch):
    vertices, faces, index = grown(patch)
    merged = merge(organ, patch, patch.to_mm(vertices), faces, index)
    before = trimesh.Trimesh(organ.vertices, organ.faces, process=False).volume
    after = trimesh.Trimesh(merged.vertices, merged.faces, process=False).volume
    assert organ.lumen_sign * (after - before) > 1


def test_every_patch_vertex_is_placed(organ, patch):
    vertices, faces, index = grown(patch)
    merged = merge(organ, patch, patch.to_mm(vertices), faces, index)
    np.testing.assert_array_equal(merged.origin[merged.placed], index)
    np.testing.assert_allclose(
        merged.vertices[merged.placed], patch.to_mm(vertices), atol=1e-12
    )


def test_the_rim_takes_the_organs_coordinates_to_the_last_bit(organ, patch):
    vertices, faces, index = grown(patch)
    merged = merge(organ, patch, patch.to_mm(vertices) + 1e-9, faces, index)
    rim = np.flatnonzero(patch.rim)
    np.testing.assert_array_equal(
        merged.vertices[merged.placed[rim]], organ.vertices[patch.organ_index[rim]]
    )


def test_an_organ_a_kilometre_away_keeps_every_bit(bubble):
    far = Organ("far", bubble.vertices + 1e6, bubble.faces)
    patch = cut_patch(far, locate_site(far, tuple(far.vertices[7])), 5.0, r0_mm=1.0)
    vertices, faces, index = grown(patch)
    merged = merge(far, patch, patch.to_mm(vertices), faces, index)
    old = merged.origin >= 0
    outside = old & ~np.isin(merged.origin, patch.organ_index[~patch.rim])
    np.testing.assert_array_equal(
        merged.vertices[outside], far.vertices[merged.origin[outside]]
    )
    check_surface(merged.vertices, merged.faces, "far")


def test_a_surface_without_the_patchs_rim_is_refused(organ, patch):
    row = int(np.argmax(patch.rim[patch.faces].sum(axis=1) == 2))
    faces = np.delete(patch.faces, row, axis=0)
    vertices = patch.to_mm(patch.vertices)
    with pytest.raises(OrganError, match=r"has 2 rim edges .* lacks 1 of its"):
        merge(organ, patch, vertices, faces, patch.organ_index)
