"""Closed surfaces of revolution: a polyp of known sections on a plane."""

import numpy as np


def revolve(profile, around=48, bottom=-10.0):
    """Turn a profile of (radius, height) about the z axis, and close it.

    The profile goes from the outer rim to the tip, which it does not contain but whose
    height is its last entry's second number.
    """
    *rings, (_, top) = profile
    angle = 2 * np.pi * np.arange(around) / around
    half = np.pi / around
    vertices = [
        np.stack(
            [
                r * np.cos(angle + half * (i % 2)),
                r * np.sin(angle + half * (i % 2)),
                np.full(around, z),
            ],
            axis=1,
        )
        for i, (r, z) in enumerate(rings)
    ]
    ends = np.array([[0, 0, top], [0, 0, bottom]])
    tip = around * len(rings)
    here, there = np.arange(around), np.roll(np.arange(around), -1)
    faces = []
    for i in range(len(rings) - 1):
        a, b = i * around + here, i * around + there
        c, d = a + around, b + around
        pairs = [(a, b, c), (b, d, c)] if i % 2 == 0 else [(a, d, c), (a, b, d)]
        faces += [np.stack(pair, axis=1) for pair in pairs]
    last = (len(rings) - 1) * around
    faces.append(np.stack([last + here, last + there, 0 * here + tip], axis=1))
    faces.append(np.stack([here, 0 * here + tip + 1, there], axis=1))
    return np.concatenate([*vertices, ends]), np.concatenate(faces)


def mushroom(stalk=1.5, length=4.0, head=4.0, fillet=1.0, spacing=0.4):
    """A ball on a stalk on a plane, with a fillet at the foot."""
    plane = [(r, 0.0) for r in np.arange(12.0, stalk + fillet, -spacing)]
    turn = np.linspace(0, np.pi / 2, 6)
    foot = [(stalk + fillet * (1 - np.sin(t)), fillet * (1 - np.cos(t))) for t in turn]
    shaft = [(stalk, z) for z in np.arange(fillet + spacing, length, spacing)]
    centre = length + np.sqrt(head**2 - stalk**2)
    start = np.pi - np.arcsin(stalk / head)
    ball = [
        (head * np.sin(t), centre + head * np.cos(t))
        for t in np.arange(start, 0.5 * spacing / head, -spacing / head)
    ]
    return revolve([*plane, *foot, *shaft, *ball, (0.0, centre + head)])


def dome(radius=4.0, spacing=0.4):
    """A hemisphere on a plane."""
    plane = [(r, 0.0) for r in np.arange(12.0, radius, -spacing)]
    ball = [
        (radius * np.cos(t), radius * np.sin(t))
        for t in np.arange(0, np.pi / 2 - 0.5 * spacing / radius, spacing / radius)
    ]
    return revolve([*plane, *ball, (0.0, radius)])


def label_by_height(vertices, at=0.5, width=1.0):
    """The smooth label of a lesion that is raised over the plane z = 0."""
    return np.clip(0.5 + (vertices[:, 2] - at) / width, 0, 1)
