"""Energies of the model, one term per file; forces are their derivatives."""
