"""Ensembles: several growths at once, in worker processes."""
