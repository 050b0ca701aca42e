"""Lists of near particles: cells, Verlet lists, and what is within a radius."""
