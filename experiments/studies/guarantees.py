"""The guarantees counted, pictured, and what they cost.

    python guarantees.py steps       # every accepted step of growths
    python guarantees.py operations  # every round of mesh operations
    python guarantees.py cost        # with and without collisions
    python guarantees.py pictures    # a full cavity, and through an os

Each writes its figures under ``experiments/results/``. The checks here share nothing
with what they check: sides by solid angles of a closed surface, intersections by
separating axes over all pairs of triangles, no distance and no list of the simulation.
"""

import argparse
import json
import multiprocessing
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
from cases_of_tests import coned, hourglass
from jaxtyping import Float, Int
from scipy.spatial import KDTree

import jaxgrow as jg
from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth import adaptation
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.quality import radius_ratio
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.winding import winding_number
from jaxgrow.organ import locate_site
from jaxgrow.transfer.device import get


RESULTS = Path(__file__).parents[1] / "results"

Points = Float[np.ndarray, "n 3"]


def closed_far_above(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    axis: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, "g 3"]]:
    """The patch closed by a cone to a point far up in the lumen.

    All particles are outside of it, as long as none crosses the patch.
    """
    return coned(vertices, faces, 1e3 * axis)


class StepAudit:
    """Counts accepted steps, and what is wrong after each."""

    def __init__(self, axis: Float[np.ndarray, "3"]) -> None:
        self.axis = axis
        self.count: Counter[str] = Counter()
        self.largest_move = 0.0
        self.worst_quality = 1.0

    def relax(self, particles: Any, membrane: Any = None, **more: Any) -> Any:
        """`jaxgrow.relax`, with an audit after every step."""
        assert membrane is not None
        self.count["relaxations"] += 1
        alive = get(particles.alive)
        faces = get(membrane.faces)[get(membrane.face_alive)].astype(np.int64)
        live = get(membrane.vertex_alive)
        last = [get(particles.position)[alive], get(membrane.vertices)[live]]

        def observe(nodes: Any) -> None:
            now = [get(nodes.particles)[alive], get(nodes.vertices)[live]]
            moves = [
                np.linalg.norm(a - b, axis=1).max()
                for a, b in zip(now, last, strict=True)
            ]
            self.largest_move = max(self.largest_move, *moves)
            last[:] = now
            self._look(now[0], now[1], faces)

        return relax(particles, membrane, observe=observe, **more)

    def _look(
        self, points: Points, vertices: Points, faces: Int[np.ndarray, "f 3"]
    ) -> None:
        self.count["steps"] += 1
        near = np.isfinite(points).all(axis=1)
        self.count["not finite"] += int((~near).sum())
        if self.count["steps"] % 50:  # far from the surface nothing can have crossed
            gap, _ = KDTree(vertices).query(points)
            near &= gap < 2.0
        chain = closed_far_above(vertices, faces, self.axis)
        winding = winding_number(points[near], *chain)
        self.count["particles looked at"] += int(near.sum())
        self.count["penetrations"] += int((np.abs(winding) > 0.25).sum())
        if self.count["steps"] % 10 == 0:
            self.count["steps looked at for intersections"] += 1
            crossing = intersecting_pairs(vertices, faces)
            self.count["self-intersections"] += sum(map(len, crossing))
            shapes = radius_ratio(vertices[faces])
            self.worst_quality = min(self.worst_quality, float(shapes.min()))


LESIONS = {
    "polyp at the fundus": jg.Polyp(divisions=80, particle_mm=1.0),
    "polyp at the left cornu": jg.Polyp(
        divisions=80, particle_mm=1.0, site="left-cornu"
    ),
    "myoma in the posterior wall": jg.Myoma(
        divisions=40, particle_mm=1.0, depth_mm=2.0, site="posterior"
    ),
}
"""On patches of 4.5 r0, so that a step and its audit take milliseconds."""


LAWS = (
    {},
    {"spring_stiffness": 0.01},
    {"spring_stiffness": 0.3},
    {"adhesion": 0.35, "contact_adhesion": 1.0},
    {"pretension": 0.02},
)
"""Another one for every seed: soft, stiff, cohesive and slack; the second five seeds
with collisions from the first step on, not only once sheets have met."""


def audited(name: str, seed: int) -> dict[str, Any]:
    """Grow once, with an audit after every accepted step."""
    jax.config.update("jax_enable_x64", True)
    lesion = LESIONS[name]
    mode = ("auto", "on")[seed // len(LAWS) % 2]
    audit = StepAudit(locate_site(jg.uterus(), lesion.site).normal)
    adaptation.relax = audit.relax
    start = time.perf_counter()
    scene = jg.Scene(
        lesion=lesion,
        surroundings=jg.Surroundings(radius=4.5, collisions=mode),
        parameters=jg.Parameters(
            **{**type(lesion).mechanics, **LAWS[seed % len(LAWS)]}
        ),
    )
    growth = jg.grow(scene, seed=seed, tolerance=1e-4)
    row = {
        "lesion": name,
        "seed": seed,
        "laws": LAWS[seed % len(LAWS)],
        "collisions": mode,
        "result": growth.result.name,
        "divisions": growth.events.divisions,
        "largest_move_r0": audit.largest_move,
        "worst_quality": audit.worst_quality,
        "seconds": time.perf_counter() - start,
        "clean_at_the_end": jg.audit(growth).clean,
        **dict.fromkeys(COUNTED, 0),
        **audit.count,
    }
    print(row, file=sys.stderr, flush=True)
    return row


COUNTED = ("steps", "penetrations", "self-intersections", "not finite")


def steps(options: argparse.Namespace) -> dict[str, Any]:
    """Grow polyps and myomas until enough steps were audited."""
    kept = RESULTS / "guarantees_steps.json"
    rows: list[dict[str, Any]] = []
    if options.more and kept.exists():
        rows = json.loads(kept.read_text())["rows"]
    already = sum(row["steps"] for row in rows)
    seed = options.seed
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, context) as pool:
        while sum(row["steps"] for row in rows) - already < options.steps:
            jobs = [pool.submit(audited, name, seed) for name in LESIONS]
            for job in jobs:
                rows.append(job.result())
                write("steps", summed(rows))  # a run that is cut short keeps its rows
            seed += 1
    return summed(rows)


def summed(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The counts of all growths, and each of them."""
    return {"total": {n: sum(r[n] for r in rows) for n in COUNTED}, "rows": rows}


def write(part: str, figures: dict[str, Any]) -> None:
    """Keep the figures of a part."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"guarantees_{part}.json"
    path.write_text(json.dumps(figures, indent=1) + "\n")


def bumpy(rng: np.random.Generator, side: int = 18) -> tuple[Surface, Points]:
    """A noisy, folded grid with particles under it, spoilt enough to need fairing."""
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    plane = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * 0.8
    index = np.arange(side * side).reshape(side, side)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    rim = np.zeros(len(plane), bool)
    rim[np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]])] = True
    wave = rng.normal(size=(6, 2))
    phase, height = rng.uniform(0, 6.3, 6), rng.uniform(0.2, 0.9, 6)
    relief = (height * np.sin(plane[:, :2] @ wave.T + phase)).sum(axis=1)
    while True:
        jitter = 0.22 * rng.normal(size=plane.shape) * ~rim[:, None]
        vertices = plane + jitter
        vertices[:, 2] += relief
        if not sum(map(len, intersecting_pairs(vertices, faces))):
            break
    points = rng.uniform([0, 0, -3], [14, 14, 3], (1500, 3))
    chain = closed_far_above(vertices, faces, np.array([0.0, 0.0, 1.0]))
    below = np.abs(winding_number(points, *chain)) < 0.25
    return Surface(vertices, faces, rim), points[below]


def operations(options: argparse.Namespace) -> dict[str, Any]:
    """Spoil surfaces, fair them, and audit after every fairing."""
    rng = np.random.default_rng(options.seed)
    count: Counter[str] = Counter()
    while count["operations"] < options.operations:
        surface, points = bumpy(rng)
        largest = float(rng.uniform(0.25, 0.9))
        after, remeshing = fair(
            surface, points, max_area=largest, min_area=0.25 * largest * rng.random()
        )
        done = {n: c for n, c in remeshing.counts.items() if c and "refused" not in n}
        refused = {n: c for n, c in remeshing.counts.items() if c and "refused" in n}
        count.update(done)
        count.update(refused)
        moving = ("swapped", "collapsed", "repaired")  # a subdivision moves nothing
        count["operations"] += sum(done.get(name, 0) for name in moving)
        count["fairings"] += 1
        chain = closed_far_above(after.vertices, after.faces, np.array([0.0, 0, 1]))
        count["penetrations"] += int(
            (np.abs(winding_number(points, *chain)) > 0.25).sum()
        )
        crossing = intersecting_pairs(after.vertices, after.faces)
        count["self-intersections"] += sum(map(len, crossing))
    return dict(count)


def cost(options: argparse.Namespace) -> dict[str, Any]:
    """The same growth with collisions off, found when needed, and always on."""
    rows: dict[str, list[dict[str, float]]] = {}
    for _ in range(options.repeats + 1):
        for mode in ("off", "auto", "on"):
            around = jg.Surroundings(collisions=mode)
            scene = jg.Scene(
                lesion=jg.Polyp(divisions=options.divisions), surroundings=around
            )
            start = time.perf_counter()
            growth = jg.grow(scene)
            spent = time.perf_counter() - start
            shape = jg.shape_metrics(growth.state)
            row = {
                "seconds": spent,
                "steps": sum(r.steps for r in growth.history),
                "divisions": growth.events.divisions,
                "colliding": sum(bool(r.colliding) for r in growth.history),
                "height_mm": float(shape.height_mm),
                **{f"{n}_s": s for n, s in growth.seconds.items()},
            }
            print(mode, row, file=sys.stderr, flush=True)
            rows.setdefault(mode, []).append(row)
    warm = {mode: found[1:] for mode, found in rows.items()}  # the first one compiles
    medians = {
        mode: statistics.median(r["seconds"] for r in found)
        for mode, found in warm.items()
    }
    ratio = {
        mode: statistics.median(
            a["seconds"] / b["seconds"] for a, b in zip(found, warm["off"], strict=True)
        )
        for mode, found in warm.items()
    }
    return {"median_seconds": medians, "ratio_to_off": ratio, "rows": warm}


def pictured(name: str, scene: jg.Scene) -> dict[str, Any]:
    """Grow, write the run's folder beside the results, and keep its picture."""
    from jaxgrow.io.run_folder import write_run

    def tell(progress: jg.Progress) -> None:
        if progress.divisions % 20 == 0:
            print(name, progress, file=sys.stderr, flush=True)

    growth = jg.grow(scene, progress=tell)
    folder = Path("runs") / name
    folder.parent.mkdir(exist_ok=True)
    report = write_run(growth, folder, [])
    (RESULTS / f"{name}.png").write_bytes((folder / "growth.png").read_bytes())
    return {
        "result": growth.result.name,
        "size_mm": growth.size_mm,
        "divisions": growth.events.divisions,
        "metrics": report["outcome"]["metrics"],
        "defects": report["audit"]["defects"],
        "quality_min": report["audit"]["surface"]["quality_min"],
        "colliding_from": next(
            (r.division for r in growth.history if r.colliding), None
        ),
        "seconds": sum(growth.seconds.values()),
    }


def flat_uterus() -> jg.Organ:
    """The built-in uterus less distended: half as deep."""
    womb, squeeze = jg.uterus(), np.array([1.0, 0.5, 1.0])
    sites = {name: squeeze * point for name, point in womb.sites.items()}
    return jg.Organ("flat uterus", squeeze * womb.vertices, womb.faces, sites=sites)


def cavity() -> jg.Scene:
    """A polyp deeper than its cavity."""
    lesion = jg.Polyp(size_mm=12.0, site="anterior", particle_mm=1.2)
    return jg.Scene(organ=flat_uterus(), lesion=lesion)


def os_() -> jg.Scene:
    """A polyp that leaves its chamber of 6 mm through an os of 4 mm.

    In a chamber that it fills before it reaches the os it widens the chamber instead:
    the tissue around yields more easily.
    """
    lesion = jg.Polyp(size_mm=8.0, site="opposite", particle_mm=0.6)
    return jg.Scene(organ=hourglass(4.0, 3.0, 4.0, edge=0.7), lesion=lesion)


def picture(name: str) -> dict[str, Any]:
    """One of the two, in a process of its own."""
    jax.config.update("jax_enable_x64", True)
    return pictured(name, {"cavity": cavity, "os": os_}[name]())


def pictures(options: argparse.Namespace) -> dict[str, Any]:
    """A polyp against the opposite wall, and one that grows through an os."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, context) as pool:
        jobs = {name: pool.submit(picture, name) for name in ("cavity", "os")}
        return {name: job.result() for name, job in jobs.items()}


PARTS: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
    "steps": steps,
    "operations": operations,
    "cost": cost,
    "pictures": pictures,
}


def main() -> None:
    """Run one part and write its figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=list(PARTS))
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--more", action="store_true", help="keep the steps counted")
    parser.add_argument("--operations", type=int, default=100_000)
    parser.add_argument("--divisions", type=int, default=120)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    figures = PARTS[options.part](options)
    write(options.part, figures)
    print(json.dumps(figures.get("total", figures), indent=1))


if __name__ == "__main__":
    main()
