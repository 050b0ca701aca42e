"""Neighbour lists: cell lists, Verlet lists, and search within a radius."""
