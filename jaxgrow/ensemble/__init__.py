"""Several growths at once, in processes."""
