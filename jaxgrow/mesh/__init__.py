"""Triangle meshes on the host: fairing, proximity, audit; without JAX."""
