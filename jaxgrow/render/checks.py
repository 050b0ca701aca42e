"""Checks of a picture's arguments, with one sentence per fault."""

from __future__ import annotations

import numpy as np


def check_size(size: int) -> None:
    """Raise unless a panel of this many pixels can be drawn."""
    if not 64 <= size <= 4096:
        raise ValueError(f"size is {size}; a panel has 64 to 4096 pixels a side.")


def check_mesh(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> None:
    """Raise unless the arrays are a labelled triangle mesh."""
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise ValueError("the mesh needs triangles, and finite coordinates.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("a face names a vertex that does not exist.")
    if len(label) != len(vertices):
        raise ValueError(
            f"there are {len(label)} labels for {len(vertices)} vertices; "
            "every vertex needs one."
        )


def check_particles(
    particles: np.ndarray, species: np.ndarray, diameter: float
) -> None:
    """Raise unless the particles can be drawn."""
    if not np.isfinite(particles).all():
        raise ValueError("a particle's position is not finite.")
    if len(species) != len(particles):
        raise ValueError(
            f"there are {len(species)} species for {len(particles)} particles; "
            "every particle needs one."
        )
    if len(species) and np.min(species) < 0:
        raise ValueError("a species is negative; they count from 0 (tissue).")
    if not (np.isfinite(diameter) and diameter > 0):
        raise ValueError(f"particle_diameter is {diameter}; it must be positive (mm).")


def check_frame(site: np.ndarray, axis: np.ndarray, extent: float | None) -> None:
    """Raise unless the picture's frame is well defined."""
    if not (np.isfinite(site).all() and np.isfinite(axis).all()):
        raise ValueError("site and axis must be finite.")
    if not np.linalg.norm(axis) > 0:
        raise ValueError("axis must not be zero: it points from tissue into the lumen.")
    if extent is not None and not (np.isfinite(extent) and extent > 0):
        raise ValueError(f"extent is {extent}; it must be positive (mm), or None.")
