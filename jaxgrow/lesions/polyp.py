"""Polyp: a focus of the surface emits all particles (paper §4)."""

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Array, Float, Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.lesions.division import add_particle, Division, first_free_slot
from jaxgrow.lesions.focus import draw_emitters, least_distance, mark_foci, spread_out
from jaxgrow.lesions.lesion import Lesion
from jaxgrow.lesions.size import diameter_of, height_of, heights, RAISED, raised
from jaxgrow.mesh.surface import Surface
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.organ import Site, Tissue
from jaxgrow.organ.signed_distance import Sides
from jaxgrow.organ.tissue import HOLD
from jaxgrow.runtime.entries import Positive, SceneError
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane, Particles, replaced, Species, State
from jaxgrow.transfer.device import get, get_number, get_surface


DEEPEST = 0.5
"""Share of the free layer of tissue under a polyp in which new particles are placed."""

SESSILE_BENDING = 0.06
"""Default bending modulus of a polyp with a height, in F(0) times a twelfth of its
size: a wide focus makes one dome, where a more flexible lining has several bumps."""

SESSILE_FOCUS = 0.32, 0.018
"""Default radius of the focus of a polyp with a height, over its size: a constant, and
a factor of size over height. The width of a dome over a focus rises a little with its
height."""

HIGHEST = 0.9
"""Largest height of a sessile polyp, over its size: it is as high as wide then, and the
largest diameter is aslant."""

LOBED = 0.75
"""Share of its size at which a lobulated polyp divides into lobes."""

LOBE = 0.3
"""Radius of the focus of a lobe, in distances of the two nearest lobes."""


class Polyp(Lesion):
    """Polyp: a local overgrowth, from a focus of hyperplasia.

    The focus emits all of its particles, and grows (`jaxgrow.lesions.focus`). The size
    is the largest diameter of the surface raised above the former one.

    Attributes:
        divisions_per_step: number of divisions before the next equilibrium, of
            different vertices of the focus; 8 at most, and fewer if there are fewer
            vertices. The paper has one.
        focus_mm: radius of the focus; a wider one makes a wider neck. By default an
            eighth of the size. Under a smaller one the lining bends more easily by
            default (κ falls with R_f to the power 3/2), and the particles are smaller:
            their default size is not above it. With 0 it is a single vertex, its
            source, and all of the surface flows: the paper's rule.
        stalk_mm: height that the source grows to before the focus emits particles at
            its tip, so that the head stands on a stalk.
        lobes: number of foci into which the focus divides when the polyp has 3/4 of its
            size.
        height_mm: height over the former surface at which growth ends, of a sessile or
            flat polyp; at most 0.9 of the size, which is its width then. The width
            comes from the focus: by default its radius is a third of the size, or a
            little more, and the lining is stiffer (κ = 0.06).
        fills_cavity: whether a cavity that is full ends the growth as asked for. The
            polyp then lies against the walls all around; the size is the largest that
            it may have, and decides that of the particles.
    """

    kind: Literal["polyp"] = "polyp"
    divisions_per_step: Annotated[int, pydantic.Field(ge=1, le=8)] = 4
    focus_mm: Annotated[float, pydantic.Field(ge=0)] | None = None
    stalk_mm: Annotated[float, pydantic.Field(ge=0)] = 0.0
    lobes: Annotated[int, pydantic.Field(ge=1, le=7)] = 1
    height_mm: Positive | None = None
    fills_cavity: bool = False

    mechanics: ClassVar[dict[str, float]] = {
        "tumour_stiffness": 2.0,
        "mixed_adhesion": 0.3,
        "bending_stiffness": 0.02,
        "area_modulus": 0.02,
        "healthy_stiffness": 1.0,
        "focus_radius": 1.5,
        "contact_adhesion": 1.0,
    }
    particles_across: ClassVar[float] = 12.0
    pushes_off: ClassVar[bool] = True

    def extent(self) -> tuple[float, float]:
        """Return radius and thickness of a patch around the base, in r0.

        The patch is only a little wider than the base.
        """
        wide = 2.0 if self.height_mm is not None else 0.0
        return max(6.5, 0.5 * self.across + wide), 3.0

    def seed(
        self, surface: Surface, tissue: Tissue, site: Site
    ) -> tuple[Surface, Int[np.ndarray, " n"]]:
        """Mark the vertex nearest to the site as the source."""
        inner = np.flatnonzero(~surface.fixed)
        source = inner[np.linalg.norm(surface.vertices[inner], axis=1).argmin()]
        seeded = Surface(surface.vertices, surface.faces, surface.fixed, int(source))
        return seeded, np.full(len(tissue.points), int(Species.TISSUE))

    def check_start(self, state: State, density: float) -> None:
        """Refuse tissue that lifts the surface as a polyp would.

        Raises:
            SceneError: the measured size would be that of the lift.
        """
        if self.target_mm is not None:
            check_lift(state, density)

    def most_at_once(self, thickness: float, parameters: Parameters) -> int:
        """Return the number of particles with enough room, one below the other."""
        deepest = DEEPEST * (thickness - HOLD)
        return max(1, int(deepest / get_number(parameters.daughter_offset)))

    def next_foci(
        self, state: State, stage: int, parameters: Parameters
    ) -> tuple[int, ...]:
        """Choose the site, then the tip of a stalk, then a vertex for each lobe."""
        membrane = state.membrane
        assert membrane is not None
        source = int(membrane.source)
        if get_number(parameters.focus_radius) == 0:
            return ()
        if stage == 0:
            return (source,)
        if source >= 0:  # the stalk grows
            height = get(membrane.vertices)[source] @ get(state.frame.axis)
            return (source,) if height * self.r0_mm >= self.stalk_mm else ()
        placed = 1 + (self.stalk_mm > 0)
        grown = self.lobes > 1 and stage == placed
        if grown and get_number(self.size(state)) >= LOBED * self.across:
            return spread_out(membrane, self.lobes, state.frame)
        return ()

    def place_foci(
        self, state: State, centres: tuple[int, ...], stage: int, parameters: Parameters
    ) -> State:
        """Mark foci; the first one of a stalk keeps its source."""
        source = centres[0] if stage == 0 and self.stalk_mm > 0 else -1
        radius = parameters.focus_radius
        if get_number(radius) == 0:
            raise ValueError(
                "the recorded growth has foci, and focus_radius is 0; give the "
                "parameters that change by name, {'spring_stiffness': 0.05}, which "
                "keeps the others, or grow it anew without events."
            )
        if len(centres) > 1:
            radius = LOBE * least_distance(state, centres)
        return mark_foci(state, centres, radius, source)

    @pydantic.model_validator(mode="after")
    def _large(self) -> "Polyp":
        """Refuse to fill a cavity without a size, or with a sessile polyp."""
        if self.fills_cavity and (self.size_mm is None or self.height_mm is not None):
            raise ValueError(
                "fills_cavity is for a polyp of a size that its cavity does not hold; "
                "give size_mm, 30 for the built-in uterus, and neither divisions nor "
                "height_mm"
            )
        return self

    @pydantic.model_validator(mode="after")
    def _broad(self) -> "Polyp":
        """Refuse a height without a width that is larger."""
        if self.height_mm is None:
            return self
        if self.target_mm is None:
            raise ValueError(
                "height_mm is the height of a polyp of a given width; give size_mm, "
                "its width, instead of divisions"
            )
        if self.height_mm > HIGHEST * self.target_mm:
            raise ValueError(
                f"height_mm is {self.height_mm:g} and size_mm, the largest diameter, "
                f"{self.target_mm:g}; above {HIGHEST:g} of it a polyp is higher than "
                "wide: give size_mm alone, which is its height then"
            )
        if self.stalk_mm > 0 or self.lobes > 1:
            raise ValueError(
                "height_mm is for polyps without a stalk and lobes; leave out "
                "height_mm, or stalk_mm and lobes"
            )
        if self.height_mm < self.r0_mm:
            raise ValueError(
                f"height_mm is {self.height_mm:g}, less than one particle of "
                f"{self.r0_mm:.3g} mm; give more height, or a smaller particle_mm"
            )
        return self

    @property
    def r0_mm(self) -> float:
        """Length of r0 in mm; by default no more than the radius of the focus."""
        if self.particle_mm is not None or not self.focus_mm:
            return super().r0_mm
        return min(self.unit_mm, self.focus_mm)

    @property
    def _broadness(self) -> float:
        """Width over height of a sessile polyp; 0 of another."""
        if self.height_mm is None or self.target_mm is None:
            return 0.0
        return self.target_mm / self.height_mm

    def defaults(self) -> dict[str, float]:
        """Return the parameters of a polyp; a small focus has a flexible lining.

        To balloon out of a focus takes a pressure of some κ / R_f³. Of a stiff lining
        a small focus would make a flat dome, since the healthy endometrium round it
        rises at a lower pressure.
        """
        found = super().defaults()
        if self.focus_mm:
            usual = self.mechanics["focus_radius"] * self.unit_mm
            share = min(1.0, self.focus_mm / usual)
            found["bending_stiffness"] *= share**1.5
        if self._broadness:
            found["bending_stiffness"] = SESSILE_BENDING
            found["focus_radius"] = self.particles_across * (
                SESSILE_FOCUS[0] + SESSILE_FOCUS[1] * self._broadness
            )
        return found

    def requested(self) -> dict[str, float]:
        """Return the radius of the focus, if it is asked for."""
        if self.focus_mm is None:
            return {}
        return {"focus_radius": self.focus_mm / self.unit_mm}

    def choose(
        self,
        state: State,
        parameters: Parameters,
        rng: np.random.Generator,
        count: int,
    ) -> tuple[Division, ...] | None:
        """Place particles under the source, or under vertices drawn in the foci."""
        membrane = state.membrane
        assert membrane is not None
        source, surface = int(membrane.source), get_surface(membrane)
        if source >= 0:
            emitters = [(source, depth) for depth in range(1, count + 1)]
        else:
            drawn = draw_emitters(membrane, count, rng)
            emitters = [(vertex, 1) for vertex in drawn]
        slot, divisions = first_free_slot(state), list[Division]()
        for vertex, depth in emitters:
            far = jnp.asarray(float(depth))
            place = get(_daughter_of_source(_from(membrane, vertex), far, parameters))
            seen = replace(surface, source=vertex)
            division = choose_polyp(seen, slot + len(divisions), place, depth)
            if division is not None:
                divisions.append(division)
            elif source >= 0:
                break
        return tuple(divisions) or None

    def divide(self, state: State, division: Division, parameters: Parameters) -> State:
        """Add a particle under the source."""
        assert state.membrane is not None
        membrane = _from(state.membrane, division.source)
        slot = jnp.asarray(division.slot)
        if any(division.offset):
            offset = jnp.asarray(division.offset)
            particles = divide_polyp_to(state.particles, membrane, slot, offset)
        else:
            depth = jnp.asarray(float(division.depth))
            given = state.particles, membrane, slot, depth, parameters
            particles = divide_polyp(*given)
        return State(particles, state.membrane, state.frame)

    def share_reached(self, state: State, size_mm: Scalar, divisions: int) -> float:
        """Return the share of the size reached; of a sessile polyp, of its height."""
        if self.height_mm is None:
            return super().share_reached(state, size_mm, divisions)
        return height_of(state) * self.r0_mm / self.height_mm

    def accepts(self, result: Result) -> bool:
        """Return whether the cavity is full, and is to be filled."""
        return self.fills_cavity and result is Result.CAVITY_FULL

    def size(self, state: State) -> Scalar:
        """Measure the largest diameter of the raised surface, in r0."""
        assert state.membrane is not None
        alive = np.flatnonzero(get(state.membrane.vertex_alive))
        return diameter_of(state.membrane.vertices, alive[raised(state)])


def _from(membrane: Membrane, vertex: int) -> Membrane:
    """Return the membrane with this vertex as its source."""
    source = jnp.asarray(vertex, membrane.source.dtype)
    return replaced(membrane, source=source)


def check_lift(state: State, density: float) -> None:
    """Refuse tissue that lifts the surface as a polyp would.

    Args:
        state: relaxed, before the first division.
        density: of the tissue, per r0³, for the message.

    Raises:
        SceneError: the measured size would be that of the lift.
    """
    height = heights(state)
    if height.max() > RAISED:
        raise SceneError(
            f"tissue of density {density:g} per r0³ lifts the surface by "
            f"{height.max():.2g} r0 before anything grows, as much as counts as a "
            "lesion; ask for less density or softer springs (the defaults are 1.7 and "
            "0.04)."
        )


def source_normal(membrane: Membrane) -> Float[Array, "3"]:
    """Compute the unit normal of the membrane at its source, into the lumen.

    It is the mean of the normals of the triangles around the source, weighted by their
    areas.
    """
    corners = membrane.vertices[membrane.faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = jnp.cross(edges[:, 0], edges[:, 1])
    touching = jnp.any(membrane.faces == membrane.source, axis=1)
    here = touching & membrane.face_alive
    total = jnp.sum(jnp.where(here[:, None], area, 0), axis=0)
    length = safe_norm(total)
    return total / jnp.where(length > 0, length, 1)


def daughter_of_source(
    membrane: Membrane, depth: Scalar, parameters: Parameters
) -> Float[Array, "3"]:
    """Compute the position of a new particle by the rule, in r0.

    x = x_source - k δ n, with the depth k (see `Division.depth`), the daughter offset δ
    and the surface normal n.
    """
    start = membrane.vertices[membrane.source]
    return start - depth * parameters.daughter_offset * source_normal(membrane)


_daughter_of_source = jax.jit(daughter_of_source)


@jax.jit
def divide_polyp(
    particles: Particles,
    membrane: Membrane,
    slot: Int[Array, ""],
    depth: Float[Array, ""],
    parameters: Parameters,
) -> Particles:
    """Add a tumour particle under the source vertex: x = x_source - δ n.

    It is placed slightly inside the tissue, "to ensure that it will never fall outside
    the endometrium"; relaxation pushes it further in. Of several in one step the second
    is at 2δ, the third at 3δ. See `choose_polyp`.
    """
    return add_particle(
        particles, slot, daughter_of_source(membrane, depth, parameters)
    )


@jax.jit
def divide_polyp_to(
    particles: Particles,
    membrane: Membrane,
    slot: Int[Array, ""],
    offset: Float[Array, "3"],
) -> Particles:
    """Add a tumour particle at a given offset: x = x_source + offset."""
    return add_particle(particles, slot, membrane.vertices[membrane.source] + offset)


def choose_polyp(
    surface: Surface, slot: int, place: Float[np.ndarray, "3"], depth: int = 1
) -> Division | None:
    """Choose the division of a source, with the daughter inside the tissue.

    Under a needle-like surface the rule's normal may lead out of the tissue. Then the
    daughter is placed at the deepest point at the same distance, or at a half or a
    quarter of it.

    Args:
        surface: with the source.
        slot: of the new particle.
        place: by the rule, x_source - k δ n.
        depth: k, a multiple of δ.

    Returns:
        The choice; None if every direction leads out.
    """
    start = surface.vertices[surface.source]
    delta = float(np.linalg.norm(place - start))
    # twice as far as anything that can be nearest, with the longest edges around
    around = surface.vertices[surface.faces[(surface.faces == surface.source).any(1)]]
    box = 2 * (delta + np.abs(around - start).max())
    sides = Sides(surface.vertices, surface.faces, start - box, start + box)
    if sides.measure(place[None]).side[0] < 0:
        return Division(slot, depth=depth, source=surface.source)
    index = np.arange(_WAYS)
    height = 1 - (2 * index + 1) / _WAYS
    flat, turn = np.sqrt(1 - height**2), 2.399963 * index
    ways = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    for length in (delta, delta / 2, delta / 4):
        found = sides.measure(start + length * ways)
        deepness = np.where(found.side < 0, found.distance, 0)
        if deepness.max() > 0:
            x, y, z = length * ways[deepness.argmax()]
            offset = (float(x), float(y), float(z))
            return Division(slot, depth=depth, source=surface.source, offset=offset)
    return None


_WAYS = 256
"""Number of directions tried, spread evenly over the sphere (a Fibonacci lattice)."""
