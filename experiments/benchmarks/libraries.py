"""Host loops against libigl and ipctk: seconds, and answers to hard questions.

    pip install libigl ipctk
    python experiments/benchmarks/libraries.py

writes results/libraries.json. A library replaces a loop of `jaxgrow.kernels` where it
is as fast within `ALLOWED` and as exact. Seconds are of the processor, on one thread;
everything that a caller without anything prepared has to do is in them.
"""

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import files, version
from pathlib import Path
from typing import Any

import igl
import ipctk
import numpy as np
import trimesh
from scipy.optimize import linprog

from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.proximity import closest_on_triangles, nearest_on_mesh, Proximity
from jaxgrow.mesh.winding import winding_number


OUT = Path(__file__).parents[1] / "results" / "libraries.json"

ALLOWED = 1.3
"""A library may be slower by this factor."""

LEVELS = {3: 1000, 6: 2000}
"""Subdivisions of an icosahedron (1 280 and 81 920 faces), and points asked for."""

PAIRS = 800
"""Pairs of triangles of each hard kind."""


def rippled(level: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed surface that does not meet itself."""
    ball = trimesh.creation.icosphere(subdivisions=level)
    vertices = np.array(ball.vertices)
    vertices *= 1.0 + 0.1 * np.sin(5.0 * vertices[:, :1])
    return vertices, np.array(ball.faces, np.int64)


def seconds(calls: dict[str, Callable[[], Any]], least: int = 3) -> dict[str, float]:
    """Median seconds of each call, in turns, and the median ratio of neighbours."""
    own, library = calls.values()
    own(), library()
    taken: list[tuple[float, float]] = []
    begin = time.perf_counter()
    while len(taken) < least or time.perf_counter() - begin < 1.0:
        pair = []
        for call in (own, library):
            start = time.process_time()
            call()
            pair.append(time.process_time() - start)
        taken.append((pair[0], pair[1]))
    mine, its = zip(*taken, strict=True)
    return {
        "own_seconds": statistics.median(mine),
        "library_seconds": statistics.median(its),
        "ratio": statistics.median(b / a for a, b in taken),
    }


def meets_itself(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """By ipctk."""
    short = faces.astype(np.int32)
    mesh = ipctk.CollisionMesh(vertices, ipctk.edges(short), short)
    return ipctk.has_intersections(mesh, vertices)


def candidates(vertices: np.ndarray, faces: np.ndarray) -> list[tuple[int, int]]:
    """Pairs whose boxes meet and that share no vertex: ipctk tells no others."""
    short, phase = faces.astype(np.int32), ipctk.LBVH()
    phase.build(vertices, ipctk.edges(short), short)
    pairs = phase.detect_face_face_candidates()
    return [(pair.face0_id, pair.face1_id) for pair in pairs]


def weights(
    tree: igl.AABB, points: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What tells a foot in a face from one in an edge: libigl does not give it."""
    _, face, _ = tree.squared_distance(vertices, faces, points)
    return closest_on_triangles(points, vertices[faces[face]])


def of_pairs(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Number of pairs that meet, by the loop."""
    return sum(map(len, intersecting_pairs(vertices, faces)))


def timed(level: int, count: int) -> list[dict[str, Any]]:
    """Rows of one surface."""
    vertices, faces = rippled(level)
    rng = np.random.default_rng(0)
    places = vertices[rng.integers(len(vertices), size=count)]
    clouds = {
        "near": places * (1.0 + 0.05 * rng.normal(size=(count, 1))),
        "far": rng.normal(size=(count, 3)),
    }
    rows: list[dict[str, Any]] = []

    def row(task: str, other: str, own: Any, library: Any, difference: float) -> None:
        found = seconds({"own": own, other: library})
        known = {"task": task, "library": other, "faces": len(faces)}
        rows.append({**known, **found, "largest_difference": difference})
        print(f"{task:34} {len(faces):6} {other:7} {found['ratio']:6.2f}", flush=True)

    for name, points in clouds.items():
        tree, theirs = Proximity(vertices, faces), igl.AABB()
        theirs.init(vertices, faces)
        square, _, _ = theirs.squared_distance(vertices, faces, points)
        gap = float(np.abs(tree.nearest(points).distance - np.sqrt(square)).max())
        row(
            f"nearest of a mesh, points {name}",
            "libigl",
            lambda points=points: nearest_on_mesh(points, vertices, faces),
            lambda points=points: igl.point_mesh_squared_distance(
                points, vertices, faces
            ),
            gap,
        )
        row(
            f"nearest by a tree, points {name}",
            "libigl",
            lambda points=points, tree=tree: tree.nearest(points),
            lambda points=points, theirs=theirs: theirs.squared_distance(
                vertices, faces, points
            ),
            gap,
        )
        row(
            f"weights by a tree, points {name}",
            "libigl",
            lambda points=points, tree=tree: tree.feet(points),
            lambda points=points, theirs=theirs: weights(
                theirs, points, vertices, faces
            ),
            gap,
        )
    for few in (100, count):
        some = clouds["near"][:few]
        numbers = winding_number(some, vertices, faces)
        row(
            f"winding of {few} points",
            "libigl",
            lambda some=some: winding_number(some, vertices, faces),
            lambda some=some: igl.winding_number(vertices, faces, some),
            float(np.abs(numbers - igl.winding_number(vertices, faces, some)).max()),
        )
    same = float((of_pairs(vertices, faces) > 0) != meets_itself(vertices, faces))
    own = lambda: of_pairs(vertices, faces)
    row("meets itself", "ipctk", own, lambda: meets_itself(vertices, faces), same)
    row(
        "list of pairs, ipctk: of boxes",
        "ipctk",
        own,
        lambda: candidates(vertices, faces),
        0.0,
    )
    return rows


def truly_meet(corners: np.ndarray) -> bool:
    """Whether some weights of the corners of both are the same point: a programme."""
    equal = np.zeros((5, 6))
    equal[:3, :3], equal[:3, 3:] = corners[:3].T, -corners[3:].T
    equal[3, :3] = equal[4, 3:] = 1.0
    found = linprog(np.zeros(6), A_eq=equal, b_eq=[0, 0, 0, 1, 1], bounds=(0, None))
    return found.status == 0


def hard_pairs() -> list[dict[str, Any]]:
    """Triangles of small whole coordinates: they touch, are in one plane, or lines."""
    rng, faces, rows = np.random.default_rng(0), np.arange(6).reshape(2, 3), []
    made = rng.integers(-1, 3, (3, PAIRS, 6, 3)).astype(float)
    made[1:, :, 2] = made[1:, :, 1]
    made[2, :, 4] = made[2, :, 3]
    kinds = ("both with an area", "a segment and a triangle", "two segments")
    for least, (kind, pairs) in enumerate(zip(kinds, made, strict=True)):
        corners = pairs.reshape(-1, 2, 3, 3)
        area = np.cross(
            corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
        )
        flat = (np.abs(area).max(axis=2) == 0).sum(axis=1)
        pairs, corners = pairs[flat == least], corners[flat == least]
        truth = np.array([truly_meet(pair) for pair in pairs])
        own = np.array([of_pairs(pair, faces) > 0 for pair in pairs])
        theirs = np.array([meets_itself(pair, faces) for pair in pairs])
        rows.append(
            {
                "kind": kind,
                "pairs": len(pairs),
                "meet": int(truth.sum()),
                "missed": {
                    "own": int((truth & ~own).sum()),
                    "ipctk": int((truth & ~theirs).sum()),
                },
                "false": {
                    "own": int((own & ~truth).sum()),
                    "ipctk": int((theirs & ~truth).sum()),
                },
            }
        )
        print(rows[-1], flush=True)
    return rows


def on_the_surface() -> dict[str, Any]:
    """Points in faces, edges and vertices: they are neither inside nor outside."""
    vertices, faces = rippled(2)
    corners = vertices[faces]
    points = np.concatenate(
        [corners.mean(axis=1), corners[:, :2].mean(axis=1), vertices]
    )
    square, _, _ = igl.point_mesh_squared_distance(points, vertices, faces)
    own = winding_number(points, vertices, faces)
    theirs = igl.winding_number(vertices, faces, points)
    told = {
        n: int((np.abs(w - np.round(w)) < 1e-3).sum())
        for n, w in (("own", own), ("libigl", theirs))
    }
    nowhere = np.full((1, 3), np.nan)
    _, face, _ = igl.point_mesh_squared_distance(nowhere, vertices, faces)
    return {
        "points": len(points),
        "largest_distance": {
            "own": float(nearest_on_mesh(points, vertices, faces).distance.max()),
            "libigl": float(np.sqrt(square.max())),
        },
        "told_to_be_in_or_out": told,
        "face_of_nowhere_exists": {
            "own": bool(nearest_on_mesh(nowhere, vertices, faces).face[0] < len(faces)),
            "libigl": bool(0 <= face[0] < len(faces)),
        },
    }


def to_segments(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distance of each point to the nearest of some segments, by all pairs."""
    start, side = ends[:, 0], ends[:, 1] - ends[:, 0]
    offset = points[:, None] - start
    share = (offset * side).sum(axis=2) / (side**2).sum(axis=1)
    gap = offset - np.clip(share, 0.0, 1.0)[..., None] * side
    return np.linalg.norm(gap, axis=2).min(axis=1)


def thin() -> dict[str, Any]:
    """Distances to triangles without an area: which are wrong, and by how much."""
    rng = np.random.default_rng(1)
    points, corners = rng.normal(size=(500, 3)), rng.normal(size=(50, 3, 3))
    along = rng.random((50, 1)) * (corners[:, 1] - corners[:, 0])
    corners[:, 2] = corners[:, 0] + along
    vertices, faces = corners.reshape(-1, 3), np.arange(150).reshape(-1, 3)
    square, _, _ = igl.point_mesh_squared_distance(points, vertices, faces)
    truth = to_segments(points, corners[:, :2])
    errors = {
        "own": np.abs(nearest_on_mesh(points, vertices, faces).distance - truth),
        "libigl": np.abs(np.sqrt(square) - truth),
    }
    return {
        "points": len(points),
        "wrong": {name: int((error > 1e-9).sum()) for name, error in errors.items()},
        "largest_error": {name: float(error.max()) for name, error in errors.items()},
    }


def cost(name: str, module: str) -> dict[str, Any]:
    """Megabytes installed, and seconds to import after numpy and scipy."""
    code = (
        "import time, numpy, scipy.spatial; t = time.process_time();"
        f"import {module}; print(time.process_time() - t)"
    )
    taken = [
        float(subprocess.check_output([sys.executable, "-c", code])) for _ in range(3)
    ]
    size = sum(
        f.locate().stat().st_size for f in files(name) or () if f.locate().exists()
    )
    return {
        "version": version(name),
        "installed_megabytes": round(size / 1e6, 1),
        "import_seconds": round(min(taken), 3),
    }


def main() -> None:
    """Measure all, write and print it."""
    ipctk.set_num_threads(1)
    known = {"libigl": "igl", "ipctk": "ipctk", "numba": "numba"}
    found = {
        "allowed_ratio": ALLOWED,
        "cost": {name: cost(name, module) for name, module in known.items()},
        "pairs_of_triangles": hard_pairs(),
        "on_the_surface": on_the_surface(),
        "triangles_without_an_area": thin(),
        "timed": [row for size in LEVELS.items() for row in timed(*size)],
    }
    OUT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
