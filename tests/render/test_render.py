"""Pictures: complete, true to what is cut, the same every time, by either tracer."""

from __future__ import annotations

import os
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from jaxgrow.render import render_growth, render_surface
from jaxgrow.render.annotate import round_length
from jaxgrow.render.checks import check_mesh, check_particles
from jaxgrow.render.scene import Balls, DrawnSurface, make_surface
from jaxgrow.render.shading import SPECIES
from jaxgrow.render.subject import (
    make_subject,
    oblique_camera,
    open_surface,
    Subject,
)
from jaxgrow.render.view import see


SIZE = 128
TRACERS = ("embree", "z-buffer")
LESION_HEIGHT = 6.0


@pytest.fixture(params=TRACERS)
def tracer(request, monkeypatch) -> str:
    """Run a test with embreex and without."""
    if request.param == "embree":
        pytest.importorskip("embreex")
    else:
        monkeypatch.setitem(sys.modules, "embreex", None)
        monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    return request.param


def _sphere(rings: int = 40, around: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """A unit sphere by latitude and longitude; the first vertex is the south pole."""
    polar = np.pi * np.linspace(0, 1, rings + 1)[1:-1] ** 1.5
    turn = np.arange(around) * 2 * np.pi / around
    ring = np.stack(np.broadcast_arrays(polar[:, None], turn), axis=-1).reshape(-1, 2)
    body = np.stack(
        [
            np.sin(ring[:, 0]) * np.cos(ring[:, 1]),
            np.sin(ring[:, 0]) * np.sin(ring[:, 1]),
            -np.cos(ring[:, 0]),
        ],
        axis=1,
    )
    vertices = np.concatenate([[[0, 0, -1.0]], body, [[0, 0, 1.0]]])
    here = np.arange(around)
    there = (here + 1) % around
    last, first = len(vertices) - 1, 1 + (rings - 2) * around
    faces = [np.stack([0 * here, 1 + there, 1 + here], axis=1)]
    for row in range(rings - 2):
        low, high = 1 + row * around, 1 + (row + 1) * around
        faces.append(np.stack([low + here, low + there, high + there], axis=1))
        faces.append(np.stack([low + here, high + there, high + here], axis=1))
    faces.append(np.stack([first + here, first + there, 0 * here + last], axis=1))
    return vertices, np.concatenate(faces)


def _organ() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A round cavity with a leaning finger on its floor."""
    vertices, faces = _sphere()
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    floor = vertices[:, 2] < 0
    rise = np.exp(-((radius / 0.2) ** 4)) * floor
    vertices = 12 * vertices
    vertices[:, 2] += LESION_HEIGHT * rise
    vertices[:, 0] += 2 * rise**2
    return vertices, faces, (rise > 0.05).astype(np.int64)


def _growth() -> dict[str, Any]:
    """A finger full of tumour particles on a bed of tissue, as arguments."""
    vertices, faces, label = _organ()
    random = np.random.default_rng(7)
    up = random.uniform(0, LESION_HEIGHT - 1, 300)
    turn, off = (
        random.uniform(0, 2 * np.pi, 300),
        1.2 * random.uniform(0, 1, 300) ** 0.5,
    )
    tumour = np.stack([off * np.cos(turn), off * np.sin(turn), up - 12], axis=1)
    tumour[:, 0] += 2 * (up / LESION_HEIGHT) ** 2
    tissue = random.uniform((-5, -5, -16), (5, 5, -13), (500, 3))
    return {
        "vertices": vertices,
        "faces": faces,
        "label": label,
        "particles": np.concatenate([tissue, tumour]),
        "species": np.repeat([0, 1], [500, 300]),
        "site": np.array([0.0, 0.0, -12.0]),
        "axis": np.array([0.0, 0.0, 2.0]),
        "particle_diameter": 0.8,
        "size": SIZE,
    }


def _cluster() -> dict[str, Any]:
    position = np.random.default_rng(2).normal(size=(80, 3))
    return _growth() | {
        "vertices": None,
        "faces": None,
        "label": None,
        "particles": position,
        "species": np.repeat([0, 1], 40),
        "site": np.zeros(3),
    }


def _picture(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def _render(path: Path, growth: dict[str, Any], **changes: Any) -> np.ndarray:
    render_growth(path, **(growth | changes))
    return _picture(path)


def _panels(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return picture[:SIZE, :SIZE], picture[:SIZE, -SIZE:]


def _count(panel: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(panel - np.array(colour)).max(axis=-1) <= 3).sum())


def _subject(growth: dict[str, Any]) -> Subject:
    return make_subject(
        make_surface(growth["vertices"], growth["faces"], growth["label"]),
        Balls(growth["particles"], growth["species"], growth["particle_diameter"] / 2),
        growth["site"],
        growth["axis"],
        None,
    )


def _nothing() -> DrawnSurface:
    return make_surface(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros(0))


def test_the_page_holds_two_panels_and_a_foot(tracer, tmp_path) -> None:
    picture = _render(tmp_path / "g.png", _growth())
    assert picture.shape[1] == 2 * SIZE + SIZE // 45
    assert SIZE < picture.shape[0] < 1.4 * SIZE


def test_neither_panel_is_blank(tracer, tmp_path) -> None:
    for panel in _panels(_render(tmp_path / "g.png", _growth())):
        assert panel.std() > 20


def test_the_inner_view_shows_both_species(tracer, tmp_path) -> None:
    _, inner = _panels(_render(tmp_path / "g.png", _growth()))
    assert _count(inner, SPECIES[0]) > 100
    assert _count(inner, SPECIES[1]) > 100


def test_the_surface_view_shows_the_lesion_through_the_near_wall(
    tracer, tmp_path
) -> None:
    surface, _ = _panels(_render(tmp_path / "g.png", _growth()))
    red = surface[..., 0] - surface[..., 1] > 80
    assert red.mean() > 0.05


def test_the_same_input_gives_the_same_bytes(tracer, tmp_path) -> None:
    for name in ("a.png", "b.png"):
        render_growth(tmp_path / name, **_growth(), caption="twice")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_caption_takes_a_row_of_its_own(tmp_path) -> None:
    bare = _render(tmp_path / "a.png", _growth())
    told = _render(tmp_path / "b.png", _growth(), caption="polyp, 6 mm")
    assert len(told) > len(bare)
    assert told[len(bare) :].min() < 128


def test_a_picture_does_not_depend_on_the_orientation_of_the_faces(tmp_path) -> None:
    growth = _growth()
    one = _render(tmp_path / "a.png", growth)
    two = _render(tmp_path / "b.png", growth, faces=growth["faces"][:, ::-1].copy())
    assert (np.abs(one - two).max(axis=-1) > 8).mean() < 2e-3


def test_particles_before_the_cut_are_removed(tracer, tmp_path) -> None:
    growth = _growth()
    subject = _subject(growth)
    depth = (growth["particles"] - growth["site"]) @ subject.side
    keep = depth < subject.balls.radius
    assert 0 < keep.sum() < len(keep)
    kept = {name: growth[name][keep] for name in ("particles", "species")}
    whole = _render(tmp_path / "a.png", growth)
    assert np.array_equal(whole, _render(tmp_path / "b.png", growth | kept))


def test_particles_behind_the_cut_are_shown(tmp_path) -> None:
    growth = _growth()
    depth = (growth["particles"] - growth["site"]) @ _subject(growth).side
    kept = {name: growth[name][depth > -0.4] for name in ("particles", "species")}
    whole = _render(tmp_path / "a.png", growth)
    assert not np.array_equal(whole, _render(tmp_path / "b.png", growth | kept))


def test_extent_is_the_side_of_the_field(tmp_path) -> None:
    ball = {"particles": np.zeros((1, 3)), "species": np.ones(1, int)}
    cluster = _cluster() | ball | {"particle_diameter": 2.0}
    near = _render(tmp_path / "a.png", cluster, extent=4.0)
    far = _render(tmp_path / "b.png", cluster, extent=8.0)
    disc = [_count(_panels(picture)[1], SPECIES[1]) for picture in (near, far)]
    assert np.array(disc) / SIZE**2 == pytest.approx(
        np.pi / np.array([4, 8.0]) ** 2, rel=0.2
    )


def test_a_free_cluster_needs_no_organ(tracer, tmp_path) -> None:
    whole, inner = _panels(_render(tmp_path / "c.png", _cluster()))
    assert np.all(whole[0, 0] == 255)
    assert whole.std() > 20
    assert _count(inner, SPECIES[0]) > 20
    assert _count(inner, SPECIES[1]) > 20


def test_an_organ_may_have_no_particles(tracer, tmp_path) -> None:
    growth = _growth() | {"particles": np.zeros((0, 3)), "species": np.zeros(0, int)}
    assert _render(tmp_path / "g.png", growth).std() > 20


def test_importing_and_drawing_need_no_display_and_no_plotting(tmp_path) -> None:
    script = (
        "import sys, numpy as np\n"
        "from jaxgrow.render import render_growth\n"
        "heavy = {'embreex', 'PIL', 'matplotlib', 'trimesh'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "render_growth(sys.argv[1], vertices=None, faces=None, label=None,\n"
        "  particles=np.eye(3), species=np.arange(3), site=np.zeros(3),\n"
        "  axis=np.ones(3), particle_diameter=1.0, size=64)\n"
        "assert 'matplotlib' not in sys.modules\n"
    )
    clean = {
        name: value
        for name, value in os.environ.items()
        if name not in ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR")
    }
    clean["PYTHONPATH"] = os.pathsep.join(sys.path)
    target = tmp_path / "c.png"
    subprocess.run([sys.executable, "-c", script, str(target)], check=True, env=clean)
    assert target.exists()


def test_only_a_missing_embreex_falls_back(tmp_path, monkeypatch) -> None:
    broken = types.ModuleType("embreex.rtcore_scene")

    def fail(**_: Any) -> None:
        raise RuntimeError("broken installation")

    broken.EmbreeScene = fail
    monkeypatch.setitem(sys.modules, "embreex", types.ModuleType("embreex"))
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", broken)
    monkeypatch.setitem(
        sys.modules,
        "embreex.mesh_construction",
        types.ModuleType("embreex.mesh_construction"),
    )
    with pytest.raises(RuntimeError, match="broken installation"):
        render_growth(tmp_path / "g.png", **_growth())
    assert list(tmp_path.iterdir()) == []


def test_both_tracers_see_the_same_triangles(monkeypatch) -> None:
    pytest.importorskip("embreex")
    subject = _subject(_growth())
    camera = oblique_camera(subject, 200)
    surface = open_surface(subject.surface, camera, subject.lumen)
    cast = see(surface, subject.balls, camera)
    monkeypatch.setitem(sys.modules, "embreex", None)
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    drawn = see(surface, subject.balls, camera)
    both = cast.traced & (cast.thing == drawn.thing)
    assert both.sum() > 0.998 * cast.traced.sum()
    seen = both & (cast.thing >= 0)
    same = cast.hits.face[seen] == drawn.hits.face[seen]
    assert same.mean() > 0.998
    error = np.abs(cast.hits.distance[seen] - drawn.hits.distance[seen])
    assert np.quantile(error, 0.998) < 1e-3


def test_the_cut_contains_the_direction_in_which_the_lesion_leans() -> None:
    subject = _subject(_growth())
    assert abs(subject.side @ np.eye(3)[0]) < 0.05
    assert abs(subject.side @ subject.axis) < 1e-12


def test_a_free_side_is_where_the_axis_points() -> None:
    growth = _growth()
    flipped = growth | {"faces": growth["faces"][:, ::-1].copy()}
    assert _subject(growth).lumen == -1
    assert _subject(flipped).lumen == 1
    assert _subject(growth).embedded
    assert _subject(flipped).embedded


@pytest.mark.parametrize(
    "length, expected", [(1.0, 1), (1.9, 1), (4.99, 2), (7.0, 5), (0.03, 0.02)]
)
def test_the_scale_bar_has_a_round_length(length, expected) -> None:
    assert round_length(length) == pytest.approx(expected)


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"size": 10}, "64 to 4096"),
        ({"axis": np.zeros(3)}, "axis must not be zero"),
        ({"site": np.full(3, np.nan)}, "must be finite"),
        ({"extent": -1.0}, "extent is -1"),
        ({"particle_diameter": 0.0}, "particle_diameter is 0"),
        ({"species": np.full(800, -1)}, "species is negative"),
        ({"particles": np.full((800, 3), np.inf)}, "position is not finite"),
        ({"label": None}, "or none of the three"),
        ({"faces": np.array([[0, 1, 10**6]])}, "vertex that does not exist"),
        ({"faces": np.zeros((0, 3), int)}, "needs triangles"),
    ],
)
def test_a_bad_argument_gets_one_clear_sentence(tmp_path, changes, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        render_growth(tmp_path / "g.png", **(_growth() | changes))
    assert list(tmp_path.iterdir()) == []


def test_every_particle_needs_a_species() -> None:
    with pytest.raises(ValueError, match="3 species for 8 particles"):
        check_particles(np.zeros((8, 3)), np.zeros(3, int), 1.0)


def test_every_vertex_needs_a_label() -> None:
    with pytest.raises(ValueError, match="5 labels for 3 vertices"):
        check_mesh(np.eye(3), np.array([[0, 1, 2]]), np.zeros(5, int))


def _organ_picture(path: Path, **options: Any) -> np.ndarray:
    vertices, faces, label = _organ()
    render_surface(path, vertices, faces, label, size=SIZE, **options)
    return _picture(path)


def test_an_organ_shows_its_lesion_when_opened(tracer, tmp_path) -> None:
    def red(picture: np.ndarray) -> int:
        return int((picture[..., 0] - picture[..., 1] > 80).sum())

    shut = _organ_picture(tmp_path / "a.png")
    opened = _organ_picture(tmp_path / "b.png", inside=True, wireframe=False)
    assert red(shut) == 0
    assert red(opened) > 100


def test_an_organ_without_labels_is_drawn_healthy(tmp_path) -> None:
    vertices, faces, _ = _organ()
    render_surface(tmp_path / "o.png", vertices, faces, size=SIZE)
    assert _picture(tmp_path / "o.png").std() > 20


def test_a_direction_is_a_view_too(tmp_path) -> None:
    named = _organ_picture(tmp_path / "a.png", view="back")
    given = _organ_picture(tmp_path / "b.png", view=np.array([0, -3.0, 0]))
    assert np.array_equal(named, given)


def test_an_organ_seen_along_its_upward_direction_is_drawn(tmp_path) -> None:
    assert _organ_picture(tmp_path / "a.png", view=np.array([0, 0, 1.0])).std() > 20


def test_an_unknown_view_names_the_known_ones(tmp_path) -> None:
    with pytest.raises(ValueError, match="use one of front, back"):
        _organ_picture(tmp_path / "a.png", view="sideways")


def test_a_view_needs_a_direction(tmp_path) -> None:
    with pytest.raises(ValueError, match="must not be zero"):
        _organ_picture(tmp_path / "a.png", view=np.zeros(3))
