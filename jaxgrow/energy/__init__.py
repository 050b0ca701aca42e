"""Energies of the model: one term a file; forces are their negative derivatives."""
