"""Triangle meshes on the host: fairing, proximity, audit. Numpy only, never jax."""
