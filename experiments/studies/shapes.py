"""Shapes of polyps, measured: necks, heights, stalks, resolution, and requests.

    python experiments/studies/shapes.py STUDY ... [--seeds N] [--workers N]
                                                   [--keep DIR]

grows the lesions of a study and writes ``results/shapes_STUDY.json`` after every
growth: one row per growth with its request, result, metrics, bent edges, audit and
seconds. Rows that are there already are kept, so an interrupted study goes on.
``--keep`` writes the folder of every run too. The studies:

default     the polyp that a scene without entries asks for
neck        polyps of 12 mm by the radius of their focus alone
height      sessile and flat lesions of 8 mm, by their height
stalk       a slender polyp, its neck a fifth of its head
lobes       polyps of three and of five lobes
resolution  the same polyp of particles of three sizes, by focus and by the paper's rule
membranes   one polyp on membranes of springs and of finite elements
requests    100 requests, drawn: both kinds, all sites, sizes as published
cavity      a polyp that fills the cavity
plate       twelve lesions of different requests

With ``--keep``, neck, plate and cavity also draw their lesions of one seed side by
side, with their numbers, as ``results/shapes_STUDY.png``; resolution draws its metrics
against the size of the particles.
"""

import argparse
import json
import multiprocessing
import time
from collections.abc import Callable, Iterator
from concurrent.futures import as_completed, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
from creases import crease_angles
from shape_figures import draw_resolution, draw_side_by_side

import jaxgrow as jg


RESULTS = Path(__file__).parents[1] / "results"

Request = dict[str, Any]
"""Entries of a scene, with the ``seed`` and a ``name``."""


def polyp(
    name: str, seed: int, parameters: dict | None = None, **lesion: Any
) -> Request:
    """Request a polyp at the posterior wall."""
    entries = {"kind": "polyp", "site": "posterior", **lesion}
    return {
        "name": name,
        "seed": seed,
        "lesion": entries,
        "parameters": parameters or {},
    }


def default(seeds: int) -> Iterator[Request]:
    """Twenty polyps as a newcomer gets them."""
    for seed in range(seeds or 20):
        yield {"name": "default", "seed": seed, "lesion": {"kind": "polyp"}}


def neck(seeds: int) -> Iterator[Request]:
    """Polyps of 12 mm by the radius of their focus; narrow ones of finer particles."""
    for seed in range(seeds or 4):
        for radius, particle in NECKS.items():
            fine = particle < 1
            how = {"particle_mm": particle, "divisions_per_step": 8 if fine else 4}
            yield polyp(f"{radius:g} mm", seed, focus_mm=radius, size_mm=12.0, **how)


NECKS = {0.5: 0.55, 0.7: 0.75, 1.1: 0.9, 2.4: 1.0, 4.0: 1.0}
"""Size of the particles, by radius of the focus, in mm."""


def height(seeds: int) -> Iterator[Request]:
    """Sessile and flat lesions of 8 mm by their height alone, over their size."""
    for seed in range(seeds or 4):
        for ratio in (0.33, 0.39, 0.6, 0.9):
            yield polyp(f"{ratio:g}", seed, size_mm=8.0, height_mm=8.0 * ratio)


def stalk(seeds: int) -> Iterator[Request]:
    """Slender polyps of fine particles."""
    for seed in range(seeds or 2):
        yield polyp(
            "slender", seed, size_mm=15.0, particle_mm=0.75, stalk_mm=7.0, focus_mm=1.0
        )


def lobes(seeds: int) -> Iterator[Request]:
    """Lobulated polyps."""
    for seed in range(seeds or 2):
        yield polyp("3 lobes", seed, size_mm=12.0, particle_mm=0.75, lobes=3)
        yield polyp("5 lobes", seed, size_mm=14.0, particle_mm=0.9, lobes=5)


def resolution(seeds: int) -> Iterator[Request]:
    """One polyp of 9 mm of particles of three sizes, and the paper's rule."""
    for seed in range(seeds or 8):
        for particle in (0.9, 0.75, 0.6):
            yield polyp(f"focus {particle:g}", seed, size_mm=9.0, particle_mm=particle)
    for seed in range(seeds or 8):
        for particle in (0.9, 0.75, 0.6):
            yield polyp(
                f"paper {particle:g}",
                seed,
                PRINTED,
                size_mm=9.0,
                particle_mm=particle,
                focus_mm=0.0,
                divisions_per_step=1,
            )


PRINTED = {
    "tumour_stiffness": 1.0,
    "mixed_adhesion": 1.0,
    "bending_stiffness": 0.005,
    "area_modulus": 0.0,
    "healthy_stiffness": 0.0,
    "contact_adhesion": 0.3,
}
"""Parameters of a polyp by the paper's rule, with a little bending."""


def membranes(seeds: int) -> Iterator[Request]:
    """One polyp of 8 mm on different membranes, of the same stiffness and tension.

    Springs of stiffness k are a sheet of the modulus 2 k / √3, and those with a
    pretension τ have the tension √3 k τ.
    """
    usual = jg.Scene(lesion=jg.Polyp()).parameters
    springs, tension = usual.spring_stiffness, usual.pretension
    sheet, flowing = (
        2 * k / 3**0.5 for k in (usual.healthy_stiffness, usual.spring_stiffness)
    )
    as_energy = {"pretension": 0.0, "surface_tension": 3**0.5 * springs * tension}
    neo = {"healthy_stiffness": 0.0, "membrane_modulus": sheet}
    for seed in range(seeds or 3):
        for name, given in (
            ("springs", {}),
            ("springs, tension of the area", as_energy),
            ("neo-Hookean", neo),
            ("Kirchhoff", {"healthy_stiffness": 0.0, "kirchhoff_modulus": sheet}),
            (
                "elements alone",
                {
                    **neo,
                    **as_energy,
                    "spring_stiffness": 0.0,
                    "flowing_modulus": flowing,
                },
            ),
        ):
            yield polyp(name, seed, given, size_mm=8.0)


def requests(seeds: int) -> Iterator[Request]:
    """Draw requests: both kinds, all sites; sizes are lognormal.

    Polyps have a median of 8 mm, a factor of 1.5 as spread, and 4 to 16 mm; myomas 12
    mm, a factor of 1.4, and 6 to 18 mm, which a small cavity can hold.
    """
    rng = np.random.default_rng(2026)
    sites = list(jg.uterus().sites)
    for _ in range(seeds or 100):
        kind = "polyp" if rng.random() < 0.6 else "myoma"
        median, spread, low, high = (
            (8.0, 1.5, 4.0, 16.0) if kind == "polyp" else (12.0, 1.4, 6.0, 18.0)
        )
        size = float(np.clip(median * spread ** rng.normal(), low, high).round(1))
        site = sites[int(rng.integers(len(sites)))]
        seed = int(rng.integers(1000))
        lesion = {"kind": kind, "site": site, "size_mm": size}
        yield {"name": f"{kind} {size:g} {site}", "seed": seed, "lesion": lesion}


def cavity(seeds: int) -> Iterator[Request]:
    """A mass that fills the whole cavity, of coarse particles."""
    for seed in range(seeds or 1):
        yield polyp("cavity", seed, size_mm=30.0, particle_mm=2.0, fills_cavity=True)


def plate(seeds: int) -> Iterator[Request]:
    """Twelve lesions."""
    fine = {"size_mm": 12.0, "particle_mm": 0.75}
    seed = seeds
    yield polyp("polyp as it comes", seed, size_mm=10.0)
    yield polyp("narrow neck", seed, size_mm=12.0, focus_mm=0.9)
    yield polyp("wide neck", seed, size_mm=12.0, focus_mm=2.4)
    yield polyp("sessile", seed, size_mm=10.0, height_mm=6.0)
    yield polyp("flat", seed, size_mm=8.0, height_mm=2.6)
    yield polyp("on a stalk", seed, stalk_mm=5.0, size_mm=12.0, particle_mm=0.6)
    yield polyp("three lobes", seed, lobes=3, **fine)
    yield polyp("five lobes", seed, size_mm=14.0, particle_mm=0.9, lobes=5)
    yield polyp("at the fundus", seed, size_mm=8.0, site="fundus")
    yield polyp("in a corner", seed, size_mm=8.0, site="left-cornu")
    yield polyp("in the canal", seed, size_mm=8.0, site="isthmus")
    lesion = {"kind": "myoma", "size_mm": 10.0, "site": "posterior"}
    yield {"name": "myoma", "seed": seed, "lesion": lesion}


STUDIES: dict[str, Callable[[int], Iterator[Request]]] = {
    study.__name__: study
    for study in (
        default,
        neck,
        height,
        stalk,
        lobes,
        resolution,
        membranes,
        requests,
        cavity,
        plate,
    )
}


def bent_edges(growth: jg.Growth) -> dict[str, float]:
    """Shares of the lesion's edges bent by more than 45 and 90 degrees."""
    angle = crease_angles(growth)
    if not len(angle):
        return {}
    return {
        "above_45": float((angle > 45).mean()),
        "above_90": float((angle > 90).mean()),
        "median_angle": float(np.median(angle)),
    }


def row_of(request: Request, keep: Path | None) -> dict[str, Any]:
    """Grow a request, and measure it."""
    entries = {key: request[key] for key in ("lesion", "parameters") if key in request}
    start = time.perf_counter()
    try:
        growth = jg.grow(jg.Scene(**entries), seed=request["seed"])
    except ValueError as refusal:
        return {**request, "result": "REFUSED", "reason": str(refusal)}
    seconds = time.perf_counter() - start
    if keep is not None:
        jg.write_run(growth, keep / f"{request['name']}_{request['seed']}")
    target = growth.scene.lesion.target_mm
    audit = jg.audit(growth)
    return {
        **request,
        "result": growth.result.name,
        "size_mm": float(growth.size_mm),
        "error": None if target is None else float(growth.size_mm) / target - 1,
        "divisions": growth.events.divisions,
        "particles": int(np.asarray(growth.state.particles.alive).sum()),
        "clean": bool(audit.clean),
        "seconds": seconds,
        **bent_edges(growth),
        "metrics": jg.shape_metrics(growth.state).as_dict(),
    }


def prepare() -> None:
    """Prepare a process for growths."""
    jax.config.update("jax_enable_x64", True)
    jg.keep_programs()


def grown(
    requests: list[Request], keep: Path | None, workers: int
) -> Iterator[dict[str, Any]]:
    """Grow requests in processes of their own, and give their rows as they end."""
    if workers == 1:
        yield from (row_of(request, keep) for request in requests)
        return
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, spawn, initializer=prepare) as pool:
        waiting = [pool.submit(row_of, request, keep) for request in requests]
        for done in as_completed(waiting):
            yield done.result()


def summary(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Means over seeds with their standard errors, a line per name."""
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name and "metrics" in row]
        told = [f"{name}: {len(own)} grown"]
        for metric in ("height_to_width", "neck_to_width", "neck_width_mm"):
            values = np.array([row["metrics"][metric] for row in own])
            error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0
            told.append(f"{metric} {values.mean():.3f} ± {error:.3f}")
        for field in ("above_45", "above_90", "seconds"):
            values = [row[field] for row in own if field in row]
            told.append(f"{field} {np.mean(values):.4g}")
        yield ", ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="+", choices=list(STUDIES))
    parser.add_argument("--seeds", type=int, default=0, help="0 for the study's own")
    parser.add_argument("--keep", type=Path, help="folder for the runs")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    given = parser.parse_args()
    prepare()
    for study in given.studies:
        path = RESULTS / f"shapes_{study}.json"
        rows = json.loads(path.read_text("utf-8")) if path.exists() else []
        known = {(row["name"], row["seed"]) for row in rows}
        asked = list(STUDIES[study](given.seeds))
        left = [r for r in asked if (r["name"], r["seed"]) not in known]
        for row in grown(left, given.keep, given.workers):
            rows.append(row)
            text = json.dumps(rows, indent=1) + "\n"
            path.write_text(text, encoding="utf-8")
            print(study, row["name"], row["seed"], row["result"], flush=True)
        print("\n".join(summary(rows)))
        if study in ("neck", "plate", "cavity") and given.keep is not None:
            first = min(row["seed"] for row in rows)
            order = [request["name"] for request in asked]
            one = [row for row in rows if row["seed"] == first]
            one.sort(key=lambda row: order.index(row["name"]))
            draw_side_by_side(one, given.keep, RESULTS / f"shapes_{study}.png")
        if study == "resolution":
            draw_resolution(rows, RESULTS / "shapes_resolution.png")


if __name__ == "__main__":
    main()
