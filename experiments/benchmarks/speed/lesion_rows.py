"""Rows of whole lesions: a polyp, a myoma, and a division in very much tissue.

    python -m speed.lesion_rows organ 4000

grows one of them in a process of its own, and prints what it took and its peak memory.
All guarantees are on: collisions as soon as sheets meet, exact checks of every fairing.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
import trimesh

import jaxgrow as jg
from jaxgrow.growth.choices import Drawn
from jaxgrow.growth.initial_state import make_initial_state
from jaxgrow.growth.setup import Setup
from jaxgrow.growth.step import grow_step
from jaxgrow.runtime.timer import Clock
from jaxgrow.transfer.device import get

from .apart import apart
from .measure import configure, measure_in_turns, Options, Row
from .memory import peak


TOLERANCE = 1e-3

POLYP, QUICK_POLYP = 200, 10
"""Divisions of the polyp, in full and in quick mode."""

POLYP_SECONDS = 10.0
"""Bar of the polyp in full."""

MYOMA, QUICK_MYOMA = 300, 10

TISSUE, QUICK_TISSUE = 100_000, 4000
"""Tissue particles of the block."""

WIDER = 300.0
"""By how many r0 the block is wider and deeper that has very many triangles."""

RADIUS = 16.0
"""Of the patch on the block, in r0."""

FILLED = 950.0
"""Tissue particles under it for every r0 of depth, about."""

COARSE = 3.0
"""Longest edge of the block, in r0. The patch is refined but for its rim: at edges of
8 r0 there its triangles are so thin that the first fairing ends with `SLIVER`."""


def polyp(divisions: int) -> jg.Scene:
    """A polyp at the fundus of the built-in uterus, some 500 tissue particles under it.

    Its patch has a radius of 6.5 r0 and a thickness of 3 r0, jaxgrow's own choice.
    """
    return jg.Scene(lesion=jg.Polyp(divisions=divisions, particle_mm=1.0))


def myoma(divisions: int) -> jg.Scene:
    """A myoma under the fundus of the built-in uterus, in as much tissue as it asks."""
    return jg.Scene(lesion=jg.Myoma(divisions=divisions, particle_mm=1.0))


def organ(tissue: int, wider: float = 0.0) -> jg.Scene:
    """A polyp on a solid block with a flat top, over that many tissue particles.

    The more particles, the deeper the tissue; the patch stays the same.

    Args:
        tissue: number of particles, about.
        wider: by how many r0 the block is wider and deeper than they need.
    """
    thickness = tissue / FILLED
    across = 2 * (RADIUS + thickness + COARSE) + wider
    deep = 2 * thickness + COARSE + wider
    box = trimesh.creation.box(extents=(across, across, deep))
    box.apply_translation((0.0, 0.0, -deep / 2))
    vertices, faces = trimesh.remesh.subdivide_to_size(
        box.vertices, box.faces, COARSE, max_iter=20
    )
    block = trimesh.Trimesh(vertices, faces, process=True)
    return jg.Scene(
        organ=jg.Organ(
            "block",
            np.asarray(block.vertices),
            np.asarray(block.faces),
            "inside",
            {"top": np.zeros(3)},
        ),
        lesion=jg.Polyp(divisions=1, particle_mm=1.0, site="top"),
        surroundings=jg.Surroundings(radius=RADIUS, thickness=thickness),
    )


SCENES: dict[str, Callable[[int], jg.Scene]] = {
    "polyp": polyp,
    "myoma": myoma,
    "organ": organ,
}


def facts(growth: jg.Growth) -> dict[str, Any]:
    """Where a growth ended, and whether it is sound."""
    membrane = growth.state.membrane
    assert membrane is not None
    audit = jg.audit(growth)
    return {
        "result": growth.result.name,
        "divisions": len(growth.history),
        "size_mm": growth.size_mm,
        "height_mm": float(jg.shape_metrics(growth.state).height_mm),
        "particles": int(get(growth.state.particles.alive).sum()),
        "vertices": int(get(membrane.vertex_alive).sum()),
        "steps": sum(record.steps for record in growth.history),
        "mended": growth.mended,
        "audit_clean": audit.clean,
        "defects": audit.defects,
    }


def phases(growth: jg.Growth, seconds: float) -> dict[str, float]:
    """Seconds by the growth's own clock, and what it does not count."""
    counted = growth.seconds
    return {**counted, "not counted": seconds - sum(counted.values())}


def grown(name: str, number: int, options: Options) -> dict[str, Any]:
    """The same in a fresh process, its programs on disk if they were made before."""
    start = time.perf_counter()
    device = "--device", options.device, "--threads", options.threads
    found = apart("lesion_rows", name, number, *device)
    return {**found, "seconds_of_the_process": time.perf_counter() - start}


def lesion(
    name: str, divisions: int, options: Options, unit: float, bar: float | None
) -> Iterator[Row]:
    """A whole growth, the second one in this process and later.

    Args:
        name: of the scene.
        divisions: of the lesion.
        options: how often; at least three times, if it takes long.
        unit: seconds that the ratio counts in.
        bar: of the ratio.
    """
    scene = SCENES[name](divisions)
    measured = measure_in_turns(
        {"jaxgrow": lambda _: jg.grow(scene, tolerance=TOLERANCE)},
        options.limited(),
        shortest=0.0,
    )
    seconds, cpu = (of["jaxgrow"] for of in (measured.seconds, measured.cpu_seconds))
    growth = measured.outcomes["jaxgrow"][-1]
    fresh = {} if options.quick else {"fresh_process": grown(name, divisions, options)}
    what = "seconds a division, planting included"
    if bar is not None:
        what = f"seconds over {unit:g}"
    yield Row(
        f"{name}-{divisions}",
        f"a {name} of {divisions} divisions to {TOLERANCE:g}, grown again: {what}",
        [each / unit for each in seconds],
        cpu_ratios=[each / unit for each in cpu],
        bar=bar,
        seconds=measured.seconds,
        cpu_seconds=measured.cpu_seconds,
        errors={
            "largest_residual": max(record.residual for record in growth.history),
            "defects": sum(jg.audit(growth).defects.values()),
        },
        details={
            **facts(growth),
            "tolerance": TOLERANCE,
            "seconds_by_phase": phases(growth, seconds[-1]),
            "compilations": growth.compilations,
            **fresh,
        },
    )


def polyp_200(options: Options) -> Iterator[Row]:
    """A polyp of 200 divisions over some 500 tissue particles, against 10 s."""
    if options.quick:
        return lesion("polyp", QUICK_POLYP, options, QUICK_POLYP, None)
    return lesion("polyp", POLYP, options, POLYP_SECONDS, 1.0)


def myoma_300(options: Options) -> Iterator[Row]:
    """A myoma of 300 divisions, in seconds a division."""
    divisions = QUICK_MYOMA if options.quick else MYOMA
    return lesion("myoma", divisions, options, divisions, None)


class Divisions:
    """One division in a scene, made again and again from the planted start."""

    def __init__(self, scene: jg.Scene) -> None:
        start = time.perf_counter()
        rng = np.random.default_rng(0)
        self._setup = Setup(scene, scene.parameters, TOLERANCE)
        self.planted = make_initial_state(self._setup, rng)
        self.seconds_of_planting = time.perf_counter() - start
        self._clock = Clock()

    def __call__(self, repetition: int) -> tuple[Any, dict[str, float]]:
        """The division of a repetition, and its seconds by phase."""
        self._clock.lap()
        drawn = Drawn(np.random.default_rng(repetition))
        start = self.planted.growth_state()
        made = grow_step(self._setup, start, drawn, self._clock, 1)
        jax.block_until_ready(made.now.state)
        return made, self._clock.lap()


def organ_1e5(options: Options) -> Iterator[Row]:
    """One division over 10^5 tissue particles, in seconds; planted once.

    Every repetition divides anew from the planted start. Memory is the peak of a
    process of its own that plants and divides.
    """
    tissue = QUICK_TISSUE if options.quick else TISSUE
    divide = Divisions(organ(tissue))
    measured = measure_in_turns(
        {"jaxgrow": divide},
        options.limited(),
        shortest=0.0,
    )
    made, by_phase = measured.outcomes["jaxgrow"][-1]
    assert made.settled is not None
    assert divide.planted.outcome is not None
    stats = made.settled.found.relaxation.stats
    state = made.now.state
    fresh = grown("organ", tissue, options)
    yield Row(
        f"organ-{tissue}",
        f"one division to {TOLERANCE:g} over {tissue} tissue particles, in seconds",
        measured.seconds["jaxgrow"],
        cpu_ratios=measured.cpu_seconds["jaxgrow"],
        seconds=measured.seconds,
        cpu_seconds=measured.cpu_seconds,
        errors={"residual": stats.residual, "defects": sum(fresh["defects"].values())},
        details={
            "particles": int(get(state.particles.alive).sum()),
            "vertices": int(get(state.membrane.vertex_alive).sum()),
            "result": made.result.name,
            "steps": stats.steps,
            "tolerance": TOLERANCE,
            "seconds_of_planting": divide.seconds_of_planting,
            "residual_of_planting": divide.planted.outcome.stats.residual,
            "steps_of_planting": divide.planted.outcome.stats.steps,
            "seconds_by_phase": by_phase,
            "fresh_process": fresh,
        },
    )


def fairing(options: Options) -> Iterator[Row]:
    """Fairing after a division, in an organ of very many triangles over one of few.

    The patch is the same in both, and so is what is to be faired.
    """
    few, many = (Divisions(organ(QUICK_TISSUE, wider)) for wider in (0.0, WIDER))
    measured = measure_in_turns({"few": few, "many": many}, options, shortest=0.0)
    seconds = {
        name: [by_phase["fair"] for _, by_phase in outcomes]
        for name, outcomes in measured.outcomes.items()
    }
    faces = {
        name: len(divide.scene.organ.faces)
        for name, divide in (("few", few), ("many", many))
    }
    yield Row(
        "fairing",
        f"fairing after a division: an organ of {faces['many']} triangles over one of "
        f"{faces['few']}, the same patch",
        [a / b for a, b in zip(seconds["many"], seconds["few"], strict=True)],
        bar=1.3,
        seconds=seconds,
        details={
            "faces_of_the_organ": faces,
            "faces_of_the_patch": {
                name: int(get(outcomes[-1][0].step.state.membrane.face_alive).sum())
                for name, outcomes in measured.outcomes.items()
            },
        },
    )


def main() -> None:
    """Grow in this process; print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=SCENES)
    parser.add_argument("number", type=int, help="divisions, or tissue particles")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    configure(Options(device=given.device, threads=given.threads))
    before = peak()
    start = time.perf_counter()
    growth = jg.grow(SCENES[given.name](given.number), tolerance=TOLERANCE)
    jax.block_until_ready(growth.state)
    seconds = time.perf_counter() - start
    memory = {"imports": before, "end": peak()}
    found = {
        "seconds": seconds,
        "seconds_by_phase": phases(growth, seconds),
        "compilations": growth.compilations,
        "peak_in_gb": memory,
        **facts(growth),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
