"""Equilibria of the energy, to a stated largest force."""
