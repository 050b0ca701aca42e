"""A growth that several files look at."""

import pytest

from .free_clusters import free


@pytest.fixture(scope="session")
def thirty():
    """A free cluster of thirty particles."""
    return free()
