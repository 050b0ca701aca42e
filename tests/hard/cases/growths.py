"""Hard cases of growth in an organ."""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jaxgrow as jg

from .case import Case, Found
from .examine import of_growth
from .organs import (
    ellipsoid,
    hourglass,
    in_file,
    moved,
    scaled,
    solid,
    with_lesion,
    with_slivers,
)


SMALL: dict[str, Any] = {"radius": 4.0, "thickness": 2.5}
"""A patch that is grown on in seconds; lengths in r0."""


def grown(
    organ: Callable[[], jg.Organ | None] = ellipsoid,
    kind: type[jg.Polyp] | type[jg.Myoma] = jg.Polyp,
    site: str = "bottom",
    tolerance: float = 1e-3,
    max_seconds: float | None = None,
    max_divisions: int = 3000,
    around: dict[str, Any] | None = None,
    parameters: dict[str, float] | None = None,
    seed: int = 0,
    **lesion: Any,
) -> Callable[[], Found]:
    """A case that grows a lesion.

    Args:
        organ: makes it.
        kind: of the lesion.
        site: of the lesion.
        tolerance: of every relaxation.
        max_seconds: if there is a limit.
        max_divisions: likewise.
        around: fields of the surroundings.
        parameters: of the mechanics that are not the lesion's own.
        seed: of the growth.
        lesion: further fields of the lesion.
    """

    def run() -> Found:
        lesion.setdefault("particle_mm", 1.0)
        scene = jg.Scene(
            organ=organ(),
            lesion=kind(site=site, **lesion),
            surroundings=jg.Surroundings(**(SMALL if around is None else around)),
            parameters=jg.Parameters(**{**kind.mechanics, **(parameters or {})}),
        )
        limits: dict[str, Any] = (
            {} if max_seconds is None else {"max_seconds": max_seconds}
        )
        growth = jg.grow(
            scene,
            seed=seed,
            tolerance=tolerance,
            max_divisions=max_divisions,
            **limits,
        )
        return of_growth(growth)

    return run


def from_file(file_unit: float, unit_mm: float) -> Callable[[], Found]:
    """A case that reads its organ from a file in one unit, taking it for another."""

    def run() -> Found:
        with tempfile.TemporaryDirectory() as folder:
            path = in_file(ellipsoid(), file_unit, Path(folder))
            organ = jg.load_organ(path, unit_mm=unit_mm)
        return grown(lambda: organ, site="0,0,-8", divisions=12)()

    return run


def through_an_os() -> Found:
    """A polyp of 11 mm in a chamber of 8 mm: it goes on in the canal at its far end."""
    growth = jg.grow(
        jg.Scene(
            organ=hourglass(4.0, 4.0, 6.0),
            lesion=jg.Polyp(size_mm=11.0, site="opposite", particle_mm=1.0),
        )
    )
    vertices, _, label = growth.surface()
    return of_growth(growth, lowest_mm=round(float(vertices[label == 1, 2].min()), 2))


def too_dense_for_a_size() -> Found:
    """Tissue that raises the surface by itself must not count as a lesion."""
    found = grown(size_mm=5.0, around={**SMALL, "density": 8.0})()
    early = found.outcome == "REACHED" and found.figures["divisions"] < 10
    found.defects["sizes reached by the tissue alone"] = int(early)
    return found


def two_lesions(divisions: int, **more: Any) -> Callable[[], Found]:
    """A second polyp beside the first, in the organ that has grown the first."""

    def run() -> Found:
        first = jg.grow(
            jg.Scene(
                organ=ellipsoid(),
                lesion=jg.Polyp(site="bottom", divisions=divisions, particle_mm=1.0),
                surroundings=jg.Surroundings(**SMALL),
            )
        )
        if not first.result.success:
            return of_growth(first, of="the first lesion")
        organ = with_lesion(first, ellipsoid().sites)
        found = grown(lambda: organ, site="beside", divisions=divisions, **more)()
        vertices, _, _ = first.surface()
        found.figures["first_mm"] = round(first.size_mm, 2)
        found.figures["vertices_of_the_first"] = len(vertices)
        return found

    return run


def cases() -> Iterator[Case]:
    """Growth in an organ."""
    ok = ("REACHED",)
    yield Case("polyp", "the common case", grown(divisions=12), ok)
    yield Case(
        "daughter-1e-6-in-growth",
        "every daughter is put 1e-6 r0 under the source",
        grown(divisions=12, parameters={"daughter_offset": 1e-6}),
        ok,
    )
    for factor, name in ((1e-3, "1e-3"), (1e3, "1e3")):
        yield Case(
            f"springs-{name}",
            f"springs {name} times the default",
            grown(divisions=12, parameters={"spring_stiffness": 0.04 * factor}),
            ok,
            slow=factor < 1,
        )
    yield Case(
        "smoothing-0-in-growth",
        "the printed force with its jumps, in tissue",
        grown(divisions=12, parameters={"smoothing": 0.0}),
        (*ok, "STEP_LIMIT"),
    )
    yield Case(
        "literal-law-in-growth",
        "adhesion 1 and smoothing 0, in tissue",
        grown(divisions=12, parameters={"smoothing": 0.0, "adhesion": 1.0}),
        (*ok, "STEP_LIMIT"),
        slow=True,
    )
    yield Case(
        "organ-at-1e6-mm",
        "organ coordinates 10⁶ mm from the origin",
        grown(lambda: moved(ellipsoid(), 1e6), divisions=12),
        ok,
    )
    yield Case(
        "organ-in-metres-taken-for-mm",
        "a file with coordinates in metres, and no word about it",
        from_file(1e3, 1.0),
        ("OrganError",),
        "unit",
    )
    yield Case(
        "organ-in-metres",
        "a file with coordinates in metres, and unit_mm = 1000",
        from_file(1e3, 1e3),
        ok,
    )
    yield Case(
        "organ-of-micrometres",
        "an organ in memory that is a thousand times too small",
        grown(lambda: scaled(ellipsoid(), 1e-3), divisions=12),
        ("OrganError",),
        "at least 10 % must stay",
    )
    yield Case(
        "organ-with-slivers-1e4",
        "slivers of aspect 1e4 around the site",
        grown(lambda: with_slivers(ellipsoid(), 1e4), divisions=12),
        ok,
    )
    yield Case(
        "site-on-a-sharp-edge",
        "a site on the rim of a flat cavity, where the wall turns by 180°",
        grown(lambda: ellipsoid(12.0, 12.0, 1.0), site="side", divisions=12),
        (*ok, "CAVITY_FULL"),
        slow=True,
    )
    yield Case(
        "solid-organ-thinner-than-its-tissue",
        "a solid plate of 3.6 mm: what is pushed down comes out at the other side",
        grown(lambda: solid(ellipsoid(12.0, 12.0, 1.8)), divisions=12),
        (*ok, "PATCH_TOO_SMALL"),
        slow=True,
    )
    yield Case(
        "myoma-in-a-thin-solid-organ",
        "a myoma in the middle of a plate of 3.6 mm",
        grown(
            lambda: solid(ellipsoid(12.0, 12.0, 1.8)),
            jg.Myoma,
            divisions=12,
            depth_mm=1.5,
        ),
        (*ok, "PATCH_TOO_SMALL"),
        slow=True,
    )
    yield Case(
        "tissue-far-too-dense",
        "tissue of 4 particles per r0³, more than twice as dense as it would be",
        grown(divisions=12, around={**SMALL, "density": 4.0}),
        ok,
        slow=True,
    )
    yield Case(
        "tissue-far-too-sparse",
        "tissue of 0.02 particles per r0³: the membrane hangs free",
        grown(divisions=12, around={**SMALL, "density": 0.02}),
        ok,
        slow=True,
    )
    yield Case(
        "narrow-cavity",
        "a cavity narrower than one particle",
        grown(lambda: ellipsoid(12.0, 12.0, 0.2), divisions=12),
        ok,
    )
    yield Case(
        "narrow-cavity-to-a-size",
        "a polyp of 4 mm in a cavity narrower than one particle",
        grown(lambda: ellipsoid(12.0, 12.0, 0.2), size_mm=4.0),
        ("CAVITY_FULL",),
        slow=True,
    )
    yield Case(
        "cavity-of-one-particle",
        "a cavity just as deep as a particle",
        grown(lambda: ellipsoid(12.0, 12.0, 0.6), divisions=25),
        ("CAVITY_FULL", *ok),
        slow=True,
    )
    yield Case(
        "tumour-at-the-rim",
        "a patch so small that the polyp reaches its rim",
        grown(divisions=25, around={"radius": 2.5, "thickness": 2.5}),
        (*ok, "PATCH_TOO_SMALL"),
        slow=True,
    )
    yield Case(
        "smallest-patch",
        "a patch of exactly twelve triangles",
        grown(divisions=12, around={"radius": 2.2, "thickness": 2.5}),
        (*ok, "PATCH_TOO_SMALL"),
    )
    yield Case(
        "patch-too-small-to-cut",
        "a patch of fewer than 12 triangles",
        grown(divisions=12, around={"radius": 1.0, "thickness": 2.5}),
        ("OrganError",),
        "triangles",
    )
    yield Case(
        "patch-of-nearly-everything",
        "a patch that takes nearly the whole organ",
        grown(divisions=12, around={"radius": 30.0, "thickness": 2.5}),
        ("OrganError",),
        "must stay to hold it",
    )
    yield Case(
        "tissue-thinner-than-contact",
        "no room between the membrane and the bottom of the tissue",
        grown(divisions=12, around={"radius": 4.0, "thickness": 0.5}),
        ("OrganError",),
        "gap",
    )
    yield Case(
        "tissue-all-held",
        "a layer of tissue in which every particle is held",
        grown(divisions=12, around={"radius": 4.0, "thickness": 1.2}),
        ok,
        slow=True,
    )
    yield Case(
        "myoma-that-just-touches",
        "the seed's own sphere touches the surface: depth r0/2",
        grown(kind=jg.Myoma, divisions=12, depth_mm=0.5),
        ok,
    )
    yield Case(
        "myoma-that-just-reaches",
        "a myoma of 4 mm at a depth of 2 mm: its top reaches the surface",
        grown(
            kind=jg.Myoma,
            size_mm=4.0,
            depth_mm=2.0,
            around={"radius": 5.0, "thickness": 5.0},
        ),
        ok,
        slow=True,
    )
    yield Case(
        "myoma-stiffness-300",
        "a myoma whose core is 300 times as stiff as the tissue",
        grown(kind=jg.Myoma, divisions=12, parameters={"tumour_stiffness": 300.0}),
        ok,
        slow=True,
    )
    yield Case(
        "too-dense-for-a-size",
        "a polyp of 5 mm in tissue that raises the surface by itself",
        too_dense_for_a_size,
        ("SceneError",),
        "lifts the surface",
        slow=True,
    )
    yield Case(
        "two-lesions",
        "a second polyp 4 mm beside the first one",
        two_lesions(12),
        ok,
        slow=True,
    )
    yield Case(
        "two-lesions-that-meet",
        "two polyps of 60 divisions, 4 mm from each other: they grow into each other",
        two_lesions(60),
        (*ok, "CAVITY_FULL"),
        slow=True,
    )
    yield Case(
        "polyp-too-large-for-its-cavity",
        "a polyp of 12 mm in a cavity of 9 x 9 x 5 mm",
        grown(lambda: ellipsoid(4.5, 4.5, 2.5), size_mm=12.0),
        ("CAVITY_FULL",),
        slow=True,
    )
    yield Case(
        "polyp-against-the-wall",
        "a polyp of 25 divisions under a wall 2.4 mm above its site",
        grown(lambda: ellipsoid(10.0, 10.0, 1.2), divisions=25),
        (*ok, "CAVITY_FULL"),
        slow=True,
    )
    yield Case(
        "through-an-os-of-4-mm",
        "a polyp that starts opposite to a canal of 4 mm and grows through it",
        through_an_os,
        (*ok, "CAVITY_FULL"),
        slow=True,
    )
    yield Case(
        "wall-clock",
        "a growth that may take one second",
        grown(divisions=500, max_seconds=1.0),
        ("TIME_LIMIT",),
    )
    yield Case(
        "wall-clock-at-once",
        "a growth that may take no time at all",
        grown(divisions=5, max_seconds=0.0),
        ("ValueError",),
        "max_seconds is 0",
    )
    for tolerance in (1e-1, 1e-10):
        yield Case(
            f"polyp-12-divisions-to-{tolerance:g}",
            f"twelve divisions at tolerance {tolerance:g}",
            grown(divisions=12, tolerance=tolerance),
            ok,
        )
        minutes = 30 if tolerance < 0.1 else 7
        yield Case(
            f"polyp-300-divisions-to-{tolerance:g}",
            f"a polyp in the uterus, 300 divisions at tolerance {tolerance:g}, "
            f"in {minutes} minutes",
            grown(
                lambda: jg.uterus(),
                site="fundus",
                divisions=300,
                tolerance=tolerance,
                around={},
                max_seconds=60.0 * minutes,
            ),
            # forces of a tenth hold a needle that grows across the cavity
            ok if tolerance < 0.1 else (*ok, "TIME_LIMIT", "PATCH_TOO_SMALL"),
            slow=True,
        )
