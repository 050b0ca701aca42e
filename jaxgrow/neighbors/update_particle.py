"""Update of one particle in a symmetric neighbour list."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int


class Links(NamedTuple):
    """Symmetric neighbour list.

    Attributes:
        listed: indices of the neighbours, neighbour-major; an empty entry, anywhere in
            a column, holds n.
        full: whether a point ever had more neighbours than the capacity.
    """

    listed: Int[Array, "k n"]
    full: Bool[Array, ""]


def relink(links: Links, one: Int[Array, ""], near: Bool[Array, " n"]) -> Links:
    """Replace the neighbours of one particle, from both sides.

    Args:
        links: the list before.
        one: the particle whose neighbours change.
        near: its neighbours now, without itself.
    """
    listed, full = links
    room, count = listed.shape
    known = listed[:, one]
    without = listed[:, jnp.minimum(known, count - 1)]
    without = jnp.where(without == one, count, without)
    listed = listed.at[:, known].set(without, mode="drop")
    fresh = jnp.nonzero(near, size=room, fill_value=count)[0].astype(listed.dtype)
    listed = listed.at[:, one].set(fresh)
    others = listed[:, jnp.minimum(fresh, count - 1)]
    empty = others == count
    slot = jnp.argmax(empty, axis=0)
    here = jnp.arange(room)[:, None] == slot[None]
    others = jnp.where(here & empty, one.astype(listed.dtype), others)
    listed = listed.at[:, fresh].set(others, mode="drop")
    fits = jnp.all(jnp.any(empty, axis=0) | (fresh == count))
    return Links(listed, full | ~fits | (jnp.sum(near) > room))
