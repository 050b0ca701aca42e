"""Scenes: lesion, surroundings and parameters, read and validated."""
