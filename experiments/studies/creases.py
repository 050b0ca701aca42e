"""Creases of a polyp: how much of its surface is bent sharply, by bending stiffness.

    python creases.py [--seeds 8] [--size 10] [--moduli K ...] [--rest flat]

grows the default polyp with several bending moduli, with hinges at rest where they are
flat and with hinges whose angle at rest is reset with the springs, and writes
``results/creases.json``, and with ``--pictures`` a run of each: the share of the
lesion's edges that are bent by more than 45 and 90 degrees, their median, and shape
metrics, as means over seeds with their standard errors. Rows that are not asked for are
kept as they are. An edge is the lesion's if both of its ends are; its angle is that
between the normals of its triangles.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxgrow as jg
from jaxgrow.energy.bending import Bending, hinge_angle
from jaxgrow.mesh.quality import area_vectors
from jaxgrow.mesh.topology import build_topology
from jaxgrow.runtime.compile_cache import keep_programs


RESULTS = Path(__file__).parents[1] / "results"
MODULI = (0.0, 0.002, 0.005, 0.01)
METRICS = ("height_mm", "width_mm", "neck_width_mm", "volume_mm3", "sphericity")


class ResetBending(jg.MembraneTerm):
    """Bending whose angle at rest is reset with the springs."""

    modulus_of_bending: float

    name = "reset_bending"
    size = 4
    modulus = "bending_stiffness"
    per = "edge"
    edges = 2

    def energy(self, x: Any, rest: Any, p: Any) -> Any:
        return 0.5 * self.modulus_of_bending * rest[1] * (hinge_angle(x) - rest[0]) ** 2

    def rest(self, x: Any) -> Any:
        return hinge_angle(x), Bending().rest(x)[1]

    def stencil(self, membrane: jg.Membrane) -> Any:
        return Bending().stencil(membrane)


def crease_angles(growth: jg.Growth) -> np.ndarray:
    """Angles between the triangles at the lesion's edges, in degrees."""
    vertices, faces, label = growth.surface()
    topology = build_topology(faces, len(vertices))
    inner = topology.interior & (label[topology.edges] == 1).all(axis=1)
    normal = area_vectors(vertices[faces])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    one, other = normal[topology.edge_faces[inner]].transpose(1, 0, 2)
    return np.degrees(np.arccos(np.clip((one * other).sum(axis=1), -1, 1)))


def measure(growth: jg.Growth) -> dict[str, float]:
    """Creases and shape of one growth."""
    angle, shape = crease_angles(growth), jg.shape_metrics(growth.state)
    return {
        "reached": float(growth.result.success),
        "divisions": growth.events.divisions,
        "above_45": float((angle > 45).mean()),
        "above_90": float((angle > 90).mean()),
        "median": float(np.median(angle)),
        "largest": float(angle.max()),
        **{name: float(getattr(shape, name)) for name in METRICS},
        "height_to_width": float(shape.height_mm / shape.width_mm),
        "seconds": sum(growth.seconds.values()),
    }


def write_picture(growth: jg.Growth, path: Path) -> None:
    """A picture of the lesion."""
    path.parent.mkdir(parents=True, exist_ok=True)
    jg.write_run(growth, path.with_suffix(""))


def row_of(
    modulus: float, rest: str, seeds: int, size_mm: float, pictures: Path | None
) -> dict[str, Any]:
    """Means over seeds and their standard errors."""
    flat = rest == "flat"
    scene = jg.Scene(
        lesion=jg.Polyp(size_mm=size_mm),
        parameters=jg.Parameters(bending_stiffness=modulus if flat else 0.0),
    )
    terms = () if flat else (ResetBending(modulus),)
    each = []
    for seed in range(seeds):
        growth = jg.grow(scene, seed=seed, terms=terms)
        each.append(measure(growth))
        print(modulus, rest, seed, growth.result.name, each[-1], flush=True)
        if seed == 0 and pictures is not None:
            name = f"{rest}_{modulus:g}.png"
            write_picture(growth, pictures / name)
    names = each[0]
    return {
        "bending_stiffness": modulus,
        "rest": rest,
        "size_mm": size_mm,
        "seeds": seeds,
        "mean": {n: float(np.mean([e[n] for e in each])) for n in names},
        "standard_error": {
            n: float(np.std([e[n] for e in each], ddof=1) / np.sqrt(seeds))
            for n in names
        },
        "most": {
            n: max(e[n] for e in each) for n in ("above_45", "above_90", "largest")
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--size", type=float, default=10.0)
    parser.add_argument("--moduli", type=float, nargs="*", default=MODULI)
    parser.add_argument("--rest", nargs="*", default=("flat", "reset"))
    parser.add_argument("--pictures", type=Path, help="folder of the first seeds' runs")
    parser.add_argument("--out", type=Path, default=RESULTS / "creases.json")
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    keep_programs()
    wanted = [(r, m) for r in given.rest for m in given.moduli if m > 0 or r == "flat"]
    known = json.loads(given.out.read_text("utf-8")) if given.out.exists() else []
    rows = {(row["rest"], row["bending_stiffness"]): row for row in known}
    for rest, modulus in wanted:
        row = row_of(modulus, rest, given.seeds, given.size, given.pictures)
        rows[rest, modulus] = row
        text = json.dumps([rows[key] for key in sorted(rows)], indent=1)
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
