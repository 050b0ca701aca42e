"""What every test runs under: 64 bits, strict promotion, compiled programs on disk."""

import inspect
import os
from importlib.metadata import version
from pathlib import Path


os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA:CPU cache loader noise

import jax
import pytest
from hypothesis import settings


jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Not through jaxgrow.cli: nothing of the package may be imported before the plugin of
# jaxtyping has put its type checker into the import system.
_cache = os.environ.get("JAXGROW_XLA_CACHE") or str(
    Path.home() / f".cache/jaxgrow/xla-tests/jaxlib-{version('jaxlib')}"
)
if _cache != "off":
    jax.config.update("jax_compilation_cache_dir", _cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

settings.register_profile("default", derandomize=True, deadline=None, max_examples=20)
settings.register_profile("thorough", deadline=None, max_examples=500)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


@pytest.fixture(autouse=True)
def few_programs():
    """Forget compiled programs before they are too many for a process."""
    from jaxgrow.runtime.compilations import forget_compiled

    yield
    forget_compiled(0.4)


@pytest.fixture
def registries():
    """What is registered by name, as it was, afterwards."""
    from jaxgrow.equilibrium.relaxers import RELAXERS
    from jaxgrow.io.formats.registry import FORMATS
    from jaxgrow.metrics.registry import METRICS
    from jaxgrow.organ.registry import ORGANS
    from jaxgrow.scene.scene import LESIONS

    known = [FORMATS, LESIONS, METRICS, ORGANS, RELAXERS]
    before = [dict(names) for names in known]
    yield
    for names, entries in zip(known, before, strict=True):
        names.clear()
        names.update(entries)


@pytest.fixture
def unchecked():
    """A function without the type checker that tests run under, as users have it."""
    return inspect.unwrap


@pytest.fixture
def key():
    return jax.random.key(0)


@pytest.fixture(scope="session")
def tiny_polyp():
    """A polyp of three divisions in the built-in uterus."""
    from jaxgrow.growth.grow import grow
    from jaxgrow.lesions.polyp import Polyp
    from jaxgrow.scene.scene import Scene

    return grow(Scene(lesion=Polyp(divisions=3, divisions_per_step=1)))


@pytest.fixture(scope="session")
def tiny_cluster():
    """A cluster of five particles that grew freely."""
    from jaxgrow.growth.grow import grow
    from jaxgrow.lesions.myoma import Myoma
    from jaxgrow.scene.scene import Scene

    return grow(Scene(organ=None, lesion=Myoma(divisions=4)))
