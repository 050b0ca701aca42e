"""Broad phase of collision detection: pair lists, made on the host."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgrow.energy.collision import Collisions, LOCAL
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.problem import LEAST_LISTED
from jaxgrow.mesh.collision_mesh import (
    distances_of,
    Encounters,
    encounters,
    join,
    nearest_apart,
    Sheet,
    Walls,
)
from jaxgrow.mesh.surface import Surface
from jaxgrow.numerics.capacity import capacity_for
from jaxgrow.state import Membrane
from jaxgrow.transfer.device import get, get_number, get_surface, padded, put


SKIN = 0.7
"""Extra distance, in r0, up to which pairs are listed. The device selects the near
pairs from this list (narrow phase), so a long one is cheap: 40 divisions with the term
always on take 11.8, 10.2 and 9.6 s with 0.4, 0.7 and 1.0 (6.9 s without the term). But
where a surface folds upon itself, the number of pairs grows with the cube of the
distance."""

LEAST_PAIRS = 512
"""Initial capacity of the lists."""

CAUTION = 0.5
"""Distance at which a pair of neighbours begins to repel, over that at rest."""


@dataclass(frozen=True, eq=False)
class CollisionFinder:
    """Collision broad phase of one membrane during one relaxation.

    Attributes:
        rest: the surface when its springs were reset.
        names: for each of its vertices the same vertex of the organ, or -1.
        walls: the rest of the organ, in r0 from the site, or None.
        collision_range: r_c, in r0.
        barrier_range: in collision ranges.
    """

    rest: Surface
    names: Int[np.ndarray, " m"]
    walls: Walls | None
    collision_range: float
    barrier_range: float

    @classmethod
    def of(
        cls,
        membrane: Membrane,
        names: Int[np.ndarray, " m"],
        walls: Walls | None,
        parameters: Parameters,
    ) -> "CollisionFinder":
        """Make it for a membrane whose springs have just been reset."""
        return cls(
            get_surface(membrane),
            names,
            walls,
            get_number(parameters.collision_range),
            get_number(parameters.barrier_range),
        )

    def __call__(
        self, vertices: Float[Array, "m 3"], before: Collisions | None
    ) -> Collisions:
        """List the pairs that can interact until a vertex moves half of the skin.

        Args:
            vertices: of the membrane, with its padding.
            before: a list of the wanted capacity, or None.
        """
        least = LEAST_LISTED
        sheet = self.sheet(get(vertices), self.collision_range + SKIN)
        found = encounters(
            sheet,
            apart=max(self.collision_range, least) + SKIN,
            local=max(self.barrier_range * self.collision_range, least) + SKIN,
            along=LOCAL * self.collision_range,
        )
        return self._put(sheet, found, vertices, before)

    def sheet(self, vertices: Float[np.ndarray, "m 3"], distance: float) -> Sheet:
        """Join the surface at these vertices to the walls near it."""
        count = len(self.rest.vertices)
        place = vertices[:count].astype(float)  # the host has 64 bits only
        now = Surface(place, self.rest.faces, self.rest.fixed)
        return join(now, self.names, self.walls, distance)

    def gap(self, vertices: Float[np.ndarray, "m 3"]) -> float:
        """Compute the smallest distance of two sheets, in r0.

        It is infinite beyond the collision range; the collision energy of this membrane
        is zero then.
        """
        within = self.collision_range
        sheet = self.sheet(vertices, within)
        return nearest_apart(sheet, within=within, along=LOCAL * within)

    def _put(
        self,
        sheet: Sheet,
        found: Encounters,
        vertices: Float[Array, "m 3"],
        before: Collisions | None,
    ) -> Collisions:
        slots = vertices.shape[0]
        n = sheet.n_surface
        still = sheet.vertices[n:]

        def room(count: int, name: str, least: int) -> int:
            known = least if before is None else getattr(before, name).shape[0]
            return capacity_for(count, known)

        n_still = room(len(still), "still", 64)
        # always twice as many pairs of edges: two sizes would mean more compilations
        pairs = max(len(found.vertex), -(-len(found.edges) // 2))
        n_vertex = room(pairs, "vertex", LEAST_PAIRS)
        n_edge = 2 * n_vertex

        def slot(index: np.ndarray) -> np.ndarray:
            return np.where(index < n, index, index - n + slots)

        def fitted(array: np.ndarray, capacity: int, value: float = 0) -> Array:
            if array.dtype.kind == "f":
                array = array.astype(vertices.dtype)
            return put(padded(array, capacity, value))

        vertex_margin, edge_margin = self._margins(sheet, found)
        return Collisions(
            still=fitted(still, n_still, 1e6),
            vertex=fitted(slot(found.vertex), n_vertex, slots + n_still - 1),
            corners=fitted(slot(found.corners), n_vertex),
            apart=fitted(found.vertex_apart, n_vertex),
            vertex_margin=fitted(vertex_margin, n_vertex),
            edges=fitted(slot(found.edges), n_edge),
            edge_margin=fitted(edge_margin, n_edge),
            reference=vertices,
            skin=jnp.asarray(SKIN, vertices.dtype),
            stale=jnp.zeros((), bool),
            full=jnp.zeros((), bool),
        )

    def _margins(
        self, sheet: Sheet, found: Encounters
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " q"]]:
        """Compute the distance at which each pair's barrier begins.

        In collision ranges.
        """
        rest = sheet.vertices.copy()
        rest[: sheet.n_surface] = self.rest.vertices
        vertex, edge = distances_of(rest, found)
        margins = []
        for distance, apart in (
            (vertex, found.vertex_apart),
            (edge, found.edge_apart),
        ):
            cautious = CAUTION * distance / self.collision_range
            cautious = np.minimum(self.barrier_range, cautious)
            margins.append(np.where(apart, self.barrier_range, cautious))
        return margins[0], margins[1]
